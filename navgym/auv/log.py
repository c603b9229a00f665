"""A log as its reader has it: which columns count, what they say, what a filter is to believe."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.auv.columns import Columns, doubt_unit, levered
from navgym.auv.fields import ANNOTATIONS, GEOGRAPHIC, SENSORS, Field, assign, refuse_strangers
from navgym.auv.rows import Rows, delayed
from navgym.core.checks import Array, one_of
from navgym.core.notes import Notes
from navgym.core.tables import Table
from navgym.statespace.models import LinearModel
from navgym.statespace.recording import Model

STATES = ("px", "vx", "py", "vy")
STATES_3D = (*STATES, "pz", "vz")
Origin = tuple[float, float, float]


def component_names(model: Model) -> tuple[Sequence[str], Sequence[str]]:
    """Names of a model's measurements and of its states."""
    axes = tuple(range(0, model.n, 2)), tuple(range(1, model.n, 2))
    placed = (tuple(model.position), tuple(model.velocity)) == axes and model.n in (4, 6)
    states = STATES_3D[: model.n] if placed else [f"x{i + 1}" for i in range(model.n)]
    H = np.asarray(getattr(model, "H", np.empty(0)))
    selects = H.ndim == 2 and (np.sort(H, axis=1) == [0.0] * (model.n - 1) + [1.0]).all()
    rows = H.argmax(axis=1) if selects else []
    if placed and len(set(rows)) == model.m:
        return [STATES_3D[i] for i in rows], states
    return [f"z{i + 1}" for i in range(model.m)], states


@dataclass(frozen=True, eq=False)
class Log:
    """A table whose columns are to be measurements of a model.

    Args:
        table: the file.
        model: what the user gave, or None.
        fields: the columns that count, by quantity.
        columns: the same, with what turns them into numbers.
    """

    table: Table
    believed: Model | None
    fields: Mapping[str, Field]
    columns: Columns

    @classmethod
    def of(
        cls,
        table: Table,
        model: Model | None,
        columns: Mapping[str, str],
        units: Mapping[str, str],
        missing: Sequence[str | float],
        extra: str,
        notes: Notes,
    ) -> Log:
        """Find out what the columns of a table hold; see `read_csv` for arguments and errors."""
        names, states = component_names(model) if model else (STATES, STATES)
        quantities = quantities_of([*names, *(s for s in STATES if s not in names)], states)
        fields = assign(table, quantities, columns, units)
        refuse_strangers(table, fields, quantities, extra, notes)
        log = cls(table, model, fields, Columns(table, fields, notes, missing))
        if log.columns.say_degrees_for_metres():
            moved = {name: replace(fields[old], quantity=name) for name, old in _FLAT.items()}
            fields = {q: f for q, f in fields.items() if q not in ("px", "py")} | moved
            log = cls(table, model, fields, Columns(table, fields, notes, missing))
        log.measured  # noqa: B018 - raises where there is none
        return log

    @property
    def notes(self) -> Notes:
        """Told of what was found and done."""
        return self.columns.notes

    @property
    def round(self) -> bool:
        """Whether positions are in latitude and longitude."""
        return all(name in self.fields for name in GEOGRAPHIC)

    @cached_property
    def states(self) -> Sequence[str]:
        """Names of the model's states."""
        return component_names(self.believed)[1] if self.believed else STATES

    @cached_property
    def measured(self) -> list[str]:
        """Names of the measurements; ValueError where a column for one is missing."""
        flat = ("px", "py") if self.round else ()
        deep = ("pz",) if {"height", "depth"} & self.fields.keys() else ()
        there = {*self.fields, *flat, *deep}
        if self.believed is None:
            found = [name for name in STATES if name in there]
            if not found:
                raise self._nothing()
            return found
        names = list(component_names(self.believed)[0])
        for name in names:
            if name not in there:
                self.table.find(name, f"Say which it is with columns={{{name!r}: ...}}.")
        return names

    def _nothing(self) -> ValueError:
        held = ", ".join(list(self.table.cells)[:20])
        alone = [name for name in GEOGRAPHIC if name in self.fields]
        hint = f" {alone[0]} stands without its other half." if alone else ""
        return ValueError(
            f"{self.columns.file} has no measurement column: name at least one of "
            f"{', '.join(STATES)}, or lat and lon, or say which it is with columns={{'px': ...}}. "
            f"It holds: {held}.{hint}"
        )

    # ---- what was measured ---------------------------------------------------------------------

    def measurements(
        self, held: str, lever_arm: NDArray[np.float64] | None, origin: Origin | None
    ) -> tuple[Array, Origin | None]:
        """Measurements, (T, m), NaN where lost, and the origin of positions, if they have one."""
        found: dict[str, Array] = {}
        if self.round:
            plane, origin = self.columns.plane(held, origin)
            found |= dict(zip(("px", "py"), plane.T, strict=False))
        for names in (*(SENSORS[s] for s in SENSORS), *((n,) for n in self.measured)):
            mine = [n for n in names if n in self.measured and n in self.fields and n not in found]
            if mine and names != ("pz",):
                found |= dict(zip(mine, self.columns.sensor(mine, held).T, strict=True))
        if {"px", "py"} <= found.keys() and not self.round:
            self.columns.refuse_degrees(np.stack([found["px"], found["py"]], axis=-1))
        self._deepen(found, origin)
        if lever_arm is not None:
            self._move(found, lever_arm)
        y = np.stack([found[name] for name in self.measured], axis=-1)
        y[self._lost()] = np.nan
        return y, origin

    def _deepen(self, found: dict[str, Array], origin: Origin | None) -> None:
        """Fill pz, down, from depth or height, or say that they are left out."""
        deep = [name for name in ("depth", "height") if name in self.fields]
        if "pz" in self.measured and "pz" not in found:
            values = self.columns.numbers(deep[0])
            if deep[0] == "height":
                first = values[~np.isnan(values)][:1]
                values = (first if origin is None else origin[2]) - values
            found["pz"] = values
        elif deep and "pz" not in self.measured:
            names = " and ".join(repr(self.fields[name].column) for name in deep)
            self.notes.say(f"{names} left out: the model has no third axis")

    def _move(self, found: dict[str, Array], lever_arm: NDArray[np.float64]) -> None:
        """Positions of the sensor to those of the vehicle's centre."""
        if "heading" not in self.fields:
            raise ValueError(
                f"lever_arm= needs the heading, and {self.columns.file} has no such column: say "
                "which it is with columns={'heading': ...}, or leave lever_arm out."
            )
        if not {"px", "py"} <= found.keys():
            raise ValueError("lever_arm= needs both px and py, or latitude and longitude.")
        p = np.stack([found["px"], found["py"]], axis=-1)
        moved = levered(p, self.columns.numbers("heading"), lever_arm)
        blind = int((np.isnan(moved).any(axis=1) & ~np.isnan(p).any(axis=1)).sum())
        if blind:
            self.notes.doubt(f"{blind} positions are lost: no heading in their rows")
        found["px"], found["py"] = moved.T
        self.notes.say(f"positions moved by the lever arm {lever_arm.tolist()} m")

    def _lost(self) -> NDArray[np.bool_]:
        """Flags of the columns lost and lost_*, (T, m)."""
        lost = np.zeros((len(self.table), len(self.measured)), dtype=np.bool_)
        for j, name in enumerate(self.measured):
            for flag in ("lost", f"lost_{name}"):
                if flag in self.fields:
                    lost[:, j] |= self.table.flags(self.fields[flag].column)
        return lost

    # ---- when ----------------------------------------------------------------------------------

    def times(self, scale: float | None, y: Array) -> tuple[Array, str | None]:
        """Times of the rows, s, and the date or number from which they count."""
        found = self.columns.times(scale)
        told = self.fields.get("time")
        if scale is not None or (told and told.unit) or found.kind != "number" or found.start:
            return found.seconds, found.start
        axes = [(p, v) for p, v in (("px", "vx"), ("py", "vy")) if {p, v} <= set(self.measured)]
        p, v = (
            np.stack([y[:, self.measured.index(pair[i])] for pair in axes], axis=-1)
            if axes else np.zeros((len(y), 0))
            for i in (0, 1)
        )  # fmt: skip
        return found.seconds * doubt_unit(self.columns, found, p, v), found.start

    # ---- rows ----------------------------------------------------------------------------------

    def rows(self, time: Array, y: Array, floor: float, origin: Origin | None) -> Rows:
        """All rows, in the order of the file."""
        labels = {
            name: self.table.numbers(self.fields[name].column)
            for name in ANNOTATIONS
            if name in self.fields
        }
        sigma = self.columns.sigmas(self.measured, floor)
        lines = np.asarray(self.table.lines)
        return Rows(time, lines, y, sigma, self._told_truth(origin), labels)

    def delayed(self, rows: Rows, latency: Mapping[str, float]) -> Rows:
        """Rows with late measurements at the times to which they belong."""
        if not latency:
            return rows
        late = np.zeros(len(self.measured))
        for name, seconds in latency.items():
            names = SENSORS.get(name, (("px", "py") if name in GEOGRAPHIC else (name,)))
            one_of("name in latency:", name, [*SENSORS, *GEOGRAPHIC, *self.measured])
            late[[i for i, n in enumerate(self.measured) if n in names]] = seconds
            self.notes.say(f"{name} was measured {seconds:g} s before its stamps: moved there")
        return delayed(rows, late)

    def _told_truth(self, origin: Origin | None) -> Array | None:
        """The columns of truth that the file has, (T, k), in the order of the states."""
        if self.round_truth and origin is not None:
            return self.columns.truth_plane(origin)
        names = [f"truth_{name}" for name in self.states]
        present = [name for name in names if name in self.fields]
        gone = [name for name in names if name not in present]
        if not present:
            return None
        if gone and not (gone == ["truth_vx", "truth_vy"] and self.states is STATES):
            raise ValueError(
                f"{self.columns.file} has {', '.join(present)} but not {', '.join(gone)}: truth "
                "needs every state, or at least truth_px and truth_py; add them or remove the truth "
                "columns."
            )
        remedy = "Truth is needed in every row: fill it in, or remove the truth columns."
        return np.stack([self.columns.whole(name, remedy) for name in present], axis=-1)

    @property
    def round_truth(self) -> bool:
        """Whether true positions are in latitude and longitude."""
        return self.states == STATES and all(f"truth_{name}" in self.fields for name in GEOGRAPHIC)

    def truth(self, rows: Rows) -> Array | None:
        """True states, (T, n); missing velocities are differences of positions."""
        if rows.truth is None or rows.truth.shape[1] == len(self.states):
            return rows.truth
        if len(rows) < 2:
            raise ValueError(
                f"{self.columns.file} has truth_px and truth_py but not truth_vx, truth_vy, and one "
                "row: differences need two."
            )
        x, y = rows.truth.T
        return np.stack([x, np.gradient(x, rows.time), y, np.gradient(y, rows.time)], axis=-1)

    # ---- what a filter is to believe -----------------------------------------------------------

    def noisy(self, model: Model, rows: Rows) -> Model:
        """The model with the receiver's own standard deviations as R, where the file tells any."""
        told = ~np.isnan(rows.sigma)
        if not told.any():
            return model
        if not isinstance(model, LinearModel):
            self.notes.doubt("columns of accuracy are left out: the model is not linear")
            return model
        R = np.broadcast_to(model.R, (len(rows), *model.R.shape[-2:])).copy()
        k, j = np.nonzero(told)
        R[k, j, :] = R[k, :, j] = 0.0
        R[k, j, j] = rows.sigma[k, j] ** 2
        without = int((~told & ~np.isnan(rows.y) & told.any(axis=0)).sum())
        if without:
            self.notes.say(f"{without} measurements without an accuracy have the default noise")
        names = [name for i, name in enumerate(self.measured) if told[:, i].any()]
        self.notes.say(f"R of {', '.join(names)} is the receiver's own, row by row")
        if self.believed is not None:
            return replace(model, R=R)
        # x0 passes through the first values, which may be worse than the default noise
        first = np.argmax(~np.isnan(rows.y), axis=0), np.arange(len(self.measured))
        worse = np.nanmax(np.fmax(rows.sigma[first], 0.0) ** 2 / np.diagonal(model.R))
        return replace(model, R=R, P0=model.P0 * max(1.0, float(worse)))

    def meta(self) -> dict[str, Any]:
        """What a recording keeps of the reading."""
        rows = {
            sensor: [i for i, name in enumerate(self.measured) if name in names]
            for sensor, names in SENSORS.items()
        }
        return {
            "format": "csv",
            "file": self.columns.file,
            "columns": {quantity: field.column for quantity, field in self.fields.items()},
            "groups": {sensor: index for sensor, index in rows.items() if index},
            "reading": self.notes.sentences,
        }


_FLAT = {"lat": "px", "lon": "py"}


def quantities_of(measured: Sequence[str], states: Sequence[str]) -> list[str]:
    """Every name that a column may have beside these measurements and states."""
    flags = ["lost", *(f"lost_{name}" for name in measured)]
    sigmas = [f"sigma_{name}" for name in (*measured, *SENSORS)]
    truths = [f"truth_{name}" for name in (*states, *(GEOGRAPHIC if states == STATES else ()))]
    others = ["lat", "lon", "height", "depth", "heading"]
    return ["time", "date", *measured, *flags, *truths, *ANNOTATIONS, *others, *sigmas]
