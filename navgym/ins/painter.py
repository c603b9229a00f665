"""Pictures of a running INS environment: the track, the velocity's error and deviation, parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from navgym.envs.canvas import ESTIMATE, LOST, TRUTH, Canvas
from navgym.ins.kernels import VELOCITY_UNIT
from navgym.ins.layout import STATES

if TYPE_CHECKING:
    from navgym.ins.engine import InsEngine


class InsPainter(Canvas):
    """Draws a lane: true and estimated track beside strips over time, silence of the Doppler log shaded."""

    def draw(self, engine: InsEngine, rows: Sequence[Sequence[float]]) -> None:
        """See `Canvas`."""
        names = engine.settings.action_parameters
        grid = self._figure.add_gridspec(2 + len(names), 2, width_ratios=[1.2, 1.0])
        self._track(self._figure.add_subplot(grid[:, 0]), engine)
        strips = [self._figure.add_subplot(grid[i, 1]) for i in range(2 + len(names))]
        self._errors(strips[0], engine)
        self._deviation(strips[1], engine)
        for axes, name in zip(strips[2:], names, strict=True):
            self._strip(axes, name, engine, rows)
        for axes in strips:
            _shade(axes, engine)
            axes.set_xlim(0.0, _tape(engine)["time"][-1])
            axes.tick_params(labelbottom=axes is strips[-1])
        strips[-1].set_xlabel("time, s")

    @staticmethod
    def _track(axes: Any, engine: InsEngine) -> None:
        k, tape = int(engine.stations["k"][0]), _tape(engine)
        axes.plot(tape["truth"][:k, 1], tape["truth"][:k, 0], color=TRUTH, lw=1.0, label="truth")
        trail = engine.trail[0, :k]
        axes.plot(trail[:, 1], trail[:, 0], color=ESTIMATE, lw=1.0, label="estimate")
        silent = _silent(engine)[:k]
        axes.plot(
            np.where(silent, trail[:, 1], np.nan), np.where(silent, trail[:, 0], np.nan), color=LOST, lw=2.0,
            label="log silent",
        )  # fmt: skip
        axes.set(xlabel="east, m", ylabel="north, m", aspect="equal", title=_title(engine))
        axes.legend(loc="upper left", fontsize=7, framealpha=0.8)

    @staticmethod
    def _errors(axes: Any, engine: InsEngine) -> None:
        """Error of the horizontal velocity, of this filter and of the frozen one."""
        k, tape, which = (
            int(engine.stations["k"][0]),
            _tape(engine),
            int(engine.stations["which"][0]),
        )
        error = np.hypot(*(engine.trail[0, :k, 3:5] - tape["truth"][:k, 3:5]).T)
        frozen = np.sqrt(engine.shelf.extra["scores"][which][:k, 1])
        axes.plot(tape["time"][:k], frozen, color=TRUTH, lw=0.8, label="frozen")
        axes.plot(tape["time"][:k], error, color=ESTIMATE, lw=1.0, label="this filter")
        axes.set_ylabel("error, m/s", fontsize=8)
        axes.legend(loc="upper left", fontsize=7, ncol=2, framealpha=0.8)

    @staticmethod
    def _deviation(axes: Any, engine: InsEngine) -> None:
        k, tape = int(engine.stations["k"][0]), _tape(engine)
        deviation = VELOCITY_UNIT * np.exp(engine.trail[0, :k, STATES])
        axes.plot(tape["time"][:k], deviation, color=ESTIMATE, lw=1.0)
        axes.set(yscale="log")
        axes.set_ylabel("√P_v, m/s", fontsize=8)

    @staticmethod
    def _strip(axes: Any, name: str, engine: InsEngine, rows: Sequence[Sequence[float]]) -> None:
        parameter, column = engine.space[name], engine.space.index(name)
        k, interval = int(engine.stations["k"][0]), engine.settings.decision_interval
        values = np.array([row[column] for row in rows])
        first = k - len(values) * interval
        steps = np.clip(first + interval * np.arange(len(values)), 0, None)
        axes.step(_tape(engine)["time"][steps], values, where="post", color=ESTIMATE, lw=1.2)
        axes.set(ylim=(parameter.low, parameter.high))
        if parameter.scale == "log":
            axes.set(yscale="log")
        unit = "" if parameter.unit == "1" else f", {parameter.unit}"
        axes.set_ylabel(f"{parameter.symbol}{unit}", fontsize=8)


def _tape(engine: InsEngine) -> Any:
    which = int(engine.stations["which"][0])
    return engine.shelf.tapes[which][: int(engine.stations["length"][0])]


def _silent(engine: InsEngine) -> Any:
    """Whether the last thing that the Doppler log should have said is lost, at each step."""
    which, tape = int(engine.stations["which"][0]), _tape(engine)
    events, sensors = engine.shelf.extra["events"][which], engine.shelf.extra["sensors"][which]
    events = events[: int((tape["first"] + tape["count"]).max(initial=0))]
    log = sensors["kind"][events["sensor"]] == 0
    time, lost = events["time"][log], events["lost"][log] > 0
    if not len(time):
        return np.zeros(len(tape), np.bool_)
    last = np.searchsorted(time, tape["time"] + 1e-9) - 1
    return lost[np.maximum(last, 0)] & (last >= 0)


def _shade(axes: Any, engine: InsEngine) -> None:
    """Tint where the Doppler log is silent."""
    silent, time = _silent(engine), _tape(engine)["time"]
    edges = np.flatnonzero(np.diff(np.r_[False, silent, False].astype(int)))
    for first, last in edges.reshape(-1, 2):
        axes.axvspan(time[first], time[last - 1], color="#f2dede", lw=0, zorder=0)


def _title(engine: InsEngine) -> str:
    label, k = engine.label(0), int(engine.stations["k"][0])
    tape = _tape(engine)
    names, regime = label.get("regimes"), tape["regime"][max(k - 1, 0)]
    told = f", {names[int(regime)]}" if names and len(names) > 1 and np.isfinite(regime) else ""
    return f"{label.get('scenario', 'recording')}, {tape['time'][max(k - 1, 0)]:.0f} s{told}"
