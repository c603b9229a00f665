"""A log of two IMUs on one deck, from a ROS bag, an autopilot or the like."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from navgym.core.checks import Array, one_of, within
from navgym.core.notes import Notes
from navgym.core.tables import Cells, Table
from navgym.deck.csv_log import LONGEST_GRID, recording_of
from navgym.deck.log_columns import names_of
from navgym.deck.model import DeckModel
from navgym.deck.recording import DualIMURecording, resample
from navgym.formats.channels import SECOND, Channel, Channels
from navgym.formats.choose import check_roles, chosen
from navgym.formats.kinds import read_channels
from navgym.formats.rows import ordered

ROLES = ("main", "sub")


def read_deck_log(
    path: str | os.PathLike[str],
    *,
    kind: str | None = None,
    topics: Mapping[str, str] | None = None,
    lever_arm: ArrayLike | None = None,
    samples_per_step: int | None = None,
    model: Mapping[str, Any] | DeckModel | None = None,
    longest_gap: float | None = None,
    gyro_limit: float | None = None,
    force_limit: float | None = None,
    latency: Mapping[str, float] | None = None,
    check_units: bool = True,
) -> DualIMURecording:
    """Two IMUs of a ROS bag, MCAP, ULog, dataflash log or tlog, on even steps of the main one's.

    What each kind of file holds: docs/formats.md. Samples are interpolated; within gaps, and before
    or after one of the units, they count as not received.

    Args:
        path: the file, or the folder of a ROS 2 bag.
        kind: of the file, such as "ros"; by its content by default.
        topics: names of channels by "main" and "sub"; needed unless their names say so.
        lever_arm: (3,) m, from main to sub IMU in the main IMU's axes; needed, here or in the model.
        samples_per_step: as for `navgym.deck.csv_log.read_deck_csv`; so are the others.
        model: what a filter is to believe: a `DeckModel`, or its fields as a dict.
        longest_gap: s between samples from which there is a gap; three usual steps by default.
        gyro_limit: rad/s from which rates are saturated: not received.
        force_limit: m/s², the same for specific forces.
        latency: s by which the stamps of "main" or "sub" are late.
        check_units: whether to refuse data whose units cannot be.

    Raises:
        FileNotFoundError: there is no such file.
        ImportError: naming the extra that reads such files.
        ValueError: a damaged or foreign file, not two IMUs, no lever arm.
    """
    told = check_roles(topics, ROLES)
    late = check_latency(latency)
    channels = read_channels(path, kind)
    notes = Notes(channels.path.name)
    channels.tell(notes)
    try:
        pair = [
            ordered(_unit(channels, role, told, notes.sentences), notes.sentences) for role in ROLES
        ]
        table = _table(
            channels.path, pair, [late.get(role, 0.0) for role in ROLES], longest_gap, notes
        )
    except ValueError as error:
        prefix = "" if str(error).startswith(channels.path.name) else f"{channels.path.name}: "
        raise ValueError(f"{prefix}{error}") from None
    return recording_of(
        table, gyro_unit="rad/s", lever_arm=lever_arm, samples_per_step=samples_per_step,
        model=model, gyro_limit=gyro_limit, force_limit=force_limit, check_units=check_units,
        meta={"format": "deck_log", "kind": channels.format},
    )  # fmt: skip


def check_latency(latency: Mapping[str, float] | None) -> dict[str, float]:
    """`latency` as a dict; ValueError for a unit that is none, or a value that is no number."""
    for role, seconds in (latency or {}).items():
        one_of("name in latency:", role, ROLES)
        within(f"latency of {role}", seconds, -np.inf)
    return dict(latency or {})


def _unit(channels: Channels, role: str, topics: Mapping[str, str], said: list[str]) -> Channel:
    """The IMU that a role names, as told or by its name; ValueError where that is open."""
    there = channels.of("imu")
    if role not in topics:
        named = [c.name for c in there if role in c.name.lower()]
        if len(named) != 1:
            held = ", ".join(c.name for c in there) or "none"
            raise ValueError(
                f"which IMU is the {role} one is not known: pass topics={{'main': ..., 'sub': ...}}; "
                f"the log holds {held}."
            )
        topics = {**topics, role: named[0]}
    found = chosen(channels, role, ("imu",), topics, said)
    if found is None:
        raise ValueError(f"topics.{role} must be an IMU: a deck has two.")
    return found


def _table(
    path: Path, pair: list[Channel], late: list[float], longest_gap: float | None, notes: Notes
) -> Table:
    """Both units on even steps, as the table of a ship's log."""
    start = int(pair[0].time[0])
    times = [(c.time - start) / SECOND - lag for c, lag in zip(pair, late, strict=True)]
    grid = _grid(times)
    cells = {"time": Cells.of_numbers(grid)}
    for role, channel, time in zip(ROLES, pair, times, strict=True):
        data = resample(time, channel.values, grid, longest_gap)
        columns = [*names_of(role, "gyro"), *names_of(role, "acc")]
        cells |= {n: Cells.of_numbers(v) for n, v in zip(columns, data.T, strict=True)}
    notes.say(
        f"{pair[0].name} is main, {pair[1].name} sub: on {len(grid)} even steps of {grid[1] - grid[0]:.6g} s"
    )
    return Table(path, cells, np.arange(1, len(grid) + 1), said=tuple(notes.sentences))


def _grid(times: list[Array]) -> Array:
    """Even times of the main unit's usual step, from a sample of it, while both were on."""
    last = min(t[-1] for t in times)
    first = times[0][np.searchsorted(times[0], times[1][0]).clip(max=len(times[0]) - 1)]
    usual = float(np.median(np.diff(times[0]))) if len(times[0]) > 1 else 0.0
    count = (last - first) / usual if usual > 0.0 else 0.0
    if not count >= 1.0:
        raise ValueError("the two IMUs have no time in common: check topics= and latency=.")
    if count > LONGEST_GRID * len(times[0]):
        raise ValueError(
            f"even steps of {usual:.6g} s would be {count:.3g}: a time in the log is wrong."
        )
    grid: Array = first + usual * np.arange(int(count + 1e-6) + 1)  # stamps of whole ns
    return grid
