"""Pictures of a running AUV environment: the map, the errors and the parameters in force."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navgym.envs.canvas import ESTIMATE, LOST, TRUTH, Canvas
from navgym.statespace.filters import spaces

if TYPE_CHECKING:
    from navgym.auv.engine import Engine


class Painter(Canvas):
    """Draws a lane of the AUV environment: the map, the errors and the parameters."""

    def draw(self, engine: Engine, rows: Sequence[Sequence[float]]) -> None:
        """See `Canvas`."""
        names = engine.settings.action_parameters
        grid = self._figure.add_gridspec(len(names) + 1, 2, width_ratios=(1.25, 1))
        self._map(self._figure.add_subplot(grid[:, 0]), engine)
        self._error(self._figure.add_subplot(grid[0, 1]), engine)
        for i, name in enumerate(names):
            self._strip(self._figure.add_subplot(grid[i + 1, 1]), name, engine, rows)

    def _map(self, axes: Any, engine: Engine) -> None:
        k = int(engine.stations["k"][0])
        tape = engine.shelf.tapes[int(engine.stations["which"][0])][: max(k, 1)]
        east, north = _plane(engine)
        trail = engine.trail[0, : max(k, 1)]
        axes.plot(tape["truth"][:, east], tape["truth"][:, north], color=TRUTH, lw=1, label="truth")
        axes.plot(trail[:, east], trail[:, north], color=ESTIMATE, lw=1.4, label="estimate")
        gone = tape["lost"].all(axis=1)
        axes.scatter(
            trail[gone, east],
            trail[gone, north],
            s=9,
            color=LOST,
            label="nothing received",
            zorder=3,
        )
        if k:
            _ellipse(axes, engine, (east, north))
        axes.set(xlabel="x, m", ylabel="y, m", title=_title(engine))
        axes.set_aspect("equal", adjustable="datalim")
        axes.legend(loc="best", fontsize=8, framealpha=0.8)

    @staticmethod
    def _error(axes: Any, engine: Engine) -> None:
        k = int(engine.stations["k"][0])
        tape = engine.shelf.tapes[int(engine.stations["which"][0])]
        position = list(engine.model.position)
        miss = engine.trail[0, :k][:, position] - tape["truth"][:k][:, position]
        axes.plot(tape["time"][:k], np.sqrt((miss**2).sum(1)), color=ESTIMATE, lw=1, label="filter")
        reference = np.sqrt(tape["reference_error"][:k])
        axes.plot(tape["time"][:k], reference, color=TRUTH, lw=0.8, label="reference")
        axes.set(ylabel="error, m", xlim=_span(tape))
        axes.legend(loc="upper left", fontsize=7, ncol=2, framealpha=0.8)
        axes.tick_params(labelbottom=False)

    @staticmethod
    def _strip(axes: Any, name: str, engine: Engine, rows: Sequence[Sequence[float]]) -> None:
        parameter = spaces.QIVBF[name]
        column = spaces.QIVBF.index(name)
        tape = engine.shelf.tapes[int(engine.stations["which"][0])]
        chosen = np.array([row[column] for row in rows])
        starts = np.arange(len(chosen)) * engine.settings.decision_interval
        times = tape["time"][np.minimum(starts, len(tape) - 1)]
        values = 1.0 - chosen if parameter.scale == "log-complement" else chosen
        ends = (parameter.low, parameter.high)
        if parameter.scale == "log-complement":
            ends = (1.0 - parameter.high, 1.0 - parameter.low)
        label = (
            f"1 - {parameter.symbol}" if parameter.scale == "log-complement" else parameter.symbol
        )
        axes.step(times, values, where="post", color=ESTIMATE, lw=1.2)
        if parameter.scale != "linear":
            axes.set_yscale("log")
        axes.set(ylabel=label, xlim=_span(tape), ylim=ends)
        if name == engine.settings.action_parameters[-1]:
            axes.set_xlabel("time, s")
        else:
            axes.tick_params(labelbottom=False)


def _plane(engine: Engine) -> tuple[int, int]:
    first, *rest = engine.model.position
    return first, rest[0] if rest else first


def _span(tape: NDArray[Any]) -> tuple[float, float]:
    return float(tape["time"][0]), float(tape["time"].max())


def _title(engine: Engine) -> str:
    label = engine.label(0)
    regime = engine.shelf.tapes[int(engine.stations["which"][0])]["regime"]
    k = int(engine.stations["k"][0])
    names = label.get("regimes")
    now = regime[max(k - 1, 0)]
    told = f", regime {names[int(now)]}" if names and np.isfinite(now) and len(names) > 1 else ""
    return f"{label.get('scenario', 'recording')}, sample {k}{told}"


def _ellipse(axes: Any, engine: Engine, plane: tuple[int, int]) -> None:
    """The 3-sigma ellipse of the position that the filter itself believes."""
    from matplotlib.patches import Ellipse

    P = engine.lanes["P"][0][np.ix_(plane, plane)]
    if not np.isfinite(P).all():
        return
    values, vectors = np.linalg.eigh(P)
    width, height = 6.0 * np.sqrt(np.maximum(values, 0.0))
    angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    centre = engine.lanes["x"][0][list(plane)]
    patch = Ellipse(
        (float(centre[0]), float(centre[1])), width, height, angle=angle, fill=False, color=ESTIMATE,
    )  # fmt: skip
    axes.add_patch(patch)
