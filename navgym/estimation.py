"""Run a filter over recordings: the one road from (recording, parameters) to an estimate."""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, overload

from numpy.typing import ArrayLike

from navgym._checks import Array, one_of, positive_int
from navgym.batch import Batch
from navgym.filters.catalogue import CATALOGUE, DECK_CATALOGUE, Filter
from navgym.parameters import ParameterSpace, parameter_table
from navgym.recording import Recording
from navgym.tuned import settled

if TYPE_CHECKING:
    from navgym.deck_estimation import DeckEstimate
    from navgym.dual_imu import DualIMURecording

DECISION_INTERVAL = 5  # filter steps per row of a parameter schedule, as in the environments

Parameters = Mapping[str, Any] | ArrayLike | str | os.PathLike[str] | None


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a filter made of one recording.

    Args:
        states: (T, n) posterior means; NaN after a numerical failure.
        covariances: (T, n, n) posterior covariances.
        innovations: (T, m) measurement minus its prediction; NaN where lost.
        nis: (T,) normalised innovation squared under the predicted covariance, chi-square with as
            many degrees of freedom as components were received; NaN where nothing was.
        log_likelihood: (T,) of each innovation, same convention.
        diverged: True after a numerical failure, or once the innovations have grown to a hundred
            times what the model's measurement noise explains.
        extras: further outputs of some filters, such as a bank's mode weights.
    """

    states: Array
    covariances: Array
    innovations: Array
    nis: Array
    log_likelihood: Array
    diverged: bool
    extras: Mapping[str, Array] = field(default_factory=dict)


def filters() -> dict[str, str]:
    """Every filter's name and one line on it. Those of the deck take recordings of two IMUs."""
    found = {f.name: f.summary for f in CATALOGUE.values()}
    for f in DECK_CATALOGUE.values():
        both = f"{found[f.name]}; of two IMUs: {f.summary}" if f.name in found else f.summary
        found[f.name] = both
    return found


def find(filter_name: str) -> Filter:
    """The entry for single recordings; ValueError with the nearest name if there is none."""
    if filter_name in DECK_CATALOGUE and filter_name not in CATALOGUE:
        raise ValueError(
            f"filter {filter_name!r} needs a recording of two IMUs (navgym.DualIMURecording): use "
            f"one of {', '.join(CATALOGUE)}."
        )
    return CATALOGUE[one_of("filter", filter_name, CATALOGUE)]


def parameter_space(filter_name: str, deck: bool = False) -> ParameterSpace:
    """What can be tuned in a filter; `deck` tells the deck's oracle from the other one."""
    first, then = (CATALOGUE, DECK_CATALOGUE) if deck else (DECK_CATALOGUE, CATALOGUE)
    everyone = {**first, **then}
    return everyone[one_of("filter", filter_name, everyone)].space


@overload
def estimate(
    filter_name: str,
    recording: Recording,
    parameters: Parameters = ...,
    decision_interval: int | None = ...,
) -> Estimate: ...


@overload
def estimate(
    filter_name: str,
    recording: DualIMURecording,
    parameters: Parameters = ...,
    decision_interval: int | None = ...,
) -> DeckEstimate: ...


def estimate(
    filter_name: str,
    recording: Recording | DualIMURecording,
    parameters: Parameters = None,
    decision_interval: int | None = None,
) -> Estimate | DeckEstimate:
    """Run one filter over one recording.

    Args:
        filter_name: a name of `navgym.filters()`.
        recording: what was measured: a `Recording`, or a `DualIMURecording` for the deck's filters,
            which return a `DeckEstimate`.
        parameters: a dict of tunables (missing ones at their defaults); its values may be lists
            with one number per decision interval, or the whole may be an array (intervals,
            parameters) in the order of `navgym.parameter_space`: a schedule. Its last row holds
            to the end. A path reads them from a file that tune.py wrote (`navgym.tuned`).
        decision_interval: samples per row of a schedule: 5 by default, on decks the filter steps
            that make up 1 s.

    Raises:
        ValueError: unknown filter or parameter, a value outside its range, a recording that the
            filter cannot use.
    """
    if not isinstance(recording, Recording):
        from navgym.deck_estimation import estimate_deck
        from navgym.dual_imu import DualIMURecording

        if isinstance(recording, DualIMURecording):
            return estimate_deck(filter_name, recording, parameters, decision_interval)
    batch = Batch.of([recording])
    decision_interval = DECISION_INTERVAL if decision_interval is None else decision_interval
    result = run(filter_name, batch, parameters, decision_interval, everything=True)
    return Estimate(
        states=result["states"][0],
        covariances=result["covariances"][0],
        innovations=result["innovations"][0],
        nis=result["nis"][0],
        log_likelihood=result["log_likelihood"][0],
        diverged=bool(result["diverged"][0]),
        extras={name: result[name][0] for name in result if name not in _STANDARD},
    )


_STANDARD = ("states", "covariances", "innovations", "nis", "log_likelihood", "diverged")


def run(
    filter_name: str,
    batch: Batch,
    parameters: Parameters | Sequence[Mapping[str, Any]] = None,
    decision_interval: int = DECISION_INTERVAL,
    everything: bool = False,
) -> dict[str, Array]:
    """Run one filter over a batch: arrays (N, T, ...) named as in `Estimate`.

    Args:
        filter_name: a name of `navgym.filters()`.
        batch: stacked recordings.
        parameters: as in `estimate` for all of them, or a list with one dict per recording.
        decision_interval: samples per row of a schedule.
        everything: False computes `states` and `diverged` only.
    """
    chosen = find(filter_name)
    positive_int("decision_interval", decision_interval)
    _check_linear(chosen, batch)
    if chosen.needs_scales and batch.scales is None:
        raise ValueError(
            f"filter {filter_name!r} needs the true noise scales, which only simulated recordings "
            "carry: use process_scale and measurement_scale of Recording, or another filter."
        )
    family = importlib.import_module(f"navgym.filters.{chosen.family}")
    table = parameter_table(
        chosen.space,
        settled(parameters, filter_name),
        len(batch),
        batch.y.shape[1],
        decision_interval,
    )
    outputs: dict[str, Array] = family.estimate(chosen, batch, table, decision_interval, everything)
    return outputs


def _check_linear(chosen: Filter, batch: Batch) -> None:
    """ValueError where a filter for linear models is given another one."""
    if chosen.nonlinear or "H" in (batch.models.dtype.names or ()):
        return
    able = ", ".join(f.name for f in CATALOGUE.values() if f.nonlinear)
    raise ValueError(
        f"filter {chosen.name!r} needs a LinearModel, but the recording's model is nonlinear: "
        f"use one of {able}, or give the recording a LinearModel of what it measures."
    )
