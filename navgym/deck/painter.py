"""Pictures of a running deck environment: deformation per axis, weights, parameters, sea state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from navgym.deck.alignment import STATES, THETA
from navgym.envs.canvas import ESTIMATE, LOST, TRUTH, Canvas
from navgym.inertial.flexure import ARCMIN

if TYPE_CHECKING:
    from navgym.deck.engine import DeckEngine

SHADES = ("#ffffff", "#dfe9f2", "#f6e7d8", "#e8e0ef", "#e2efdf", "#f2dede")


class DeckPainter(Canvas):
    """Draws a lane of the deck environment: θ per axis, weights and parameters over the sea state."""

    def draw(self, engine: DeckEngine, rows: Sequence[Sequence[float]]) -> None:
        """See `Canvas`."""
        names = engine.settings.action_parameters
        heights = [2, 2, 2, 1.2] + [1] * len(names)
        grid = self._figure.add_gridspec(len(heights), 1, height_ratios=heights)
        axes = [self._figure.add_subplot(cell) for cell in grid]
        for a in range(3):
            self._axis(axes[a], a, engine)
        self._weights(axes[3], engine)
        for i, name in enumerate(names):
            self._strip(axes[4 + i], name, engine, rows)
        for each in axes:
            _shade(each, engine)
            each.set_xlim(0.0, _time(engine)[-1])
            each.tick_params(labelbottom=each is axes[-1])
        axes[0].set_title(_title(engine), fontsize=10)
        _name_regimes(axes[0], engine)
        axes[-1].set_xlabel("time, s")

    @staticmethod
    def _axis(axes: Any, a: int, engine: DeckEngine) -> None:
        """True and estimated θ of one axis, with the least deviation that the model allows."""
        k, which = int(engine.stations["k"][0]), int(engine.stations["which"][0])
        time, tape = _time(engine)[:k], engine.shelf.tapes[which][:k]
        estimate = engine.trail[0, :k, THETA][:, a] / ARCMIN
        true = tape["theta"][:, a] / ARCMIN
        bound = engine.believed[0].split_deviation(time)[:, a] / ARCMIN
        axes.fill_between(
            time,
            true - bound,
            true + bound,
            color=TRUTH,
            alpha=0.15,
            lw=0,
            label="bound of the believed model (1σ)",
        )
        axes.plot(time, true, color=TRUTH, lw=0.8, label="truth")
        axes.plot(time, estimate, color=ESTIMATE, lw=1.0, label="estimate")
        axes.set_ylabel(f"θ{'xyz'[a]}, arcmin", fontsize=8)
        if a == 0:
            axes.legend(loc="upper left", fontsize=7, ncol=3, framealpha=0.8)

    @staticmethod
    def _weights(axes: Any, engine: DeckEngine) -> None:
        k = int(engine.stations["k"][0])
        weights, time = engine.trail[0, :k, STATES:], _time(engine)[:k]
        for columns, label, colour in (
            (slice(0, 3), "velocity", ESTIMATE),
            (slice(3, 6), "rate", LOST),
        ):
            axes.plot(time, weights[:, columns].min(axis=1), ".", ms=1.5, color=colour, label=label)
        axes.set(ylim=(-0.05, 1.05))
        axes.set_ylabel("least weight", fontsize=8)
        axes.legend(loc="lower left", fontsize=7, ncol=2, framealpha=0.8, markerscale=4)

    @staticmethod
    def _strip(axes: Any, name: str, engine: DeckEngine, rows: Sequence[Sequence[float]]) -> None:
        parameter, column = engine.space[name], engine.space.index(name)
        k, interval = int(engine.stations["k"][0]), engine.settings.decision_interval
        values = np.array([row[column] for row in rows])
        first = k - len(values) * interval
        times = _time(engine)[np.clip(first + interval * np.arange(len(values)), 0, None)]
        axes.step(times, values, where="post", color=ESTIMATE, lw=1.2)
        axes.set(yscale="log", ylim=(parameter.low, parameter.high))
        axes.set_yticks(
            [parameter.low, parameter.high],
            labels=[f"{v:g}" for v in (parameter.low, parameter.high)],
        )
        axes.tick_params(axis="y", which="minor", labelleft=False)
        axes.set_ylabel(
            f"{parameter.symbol}{'' if parameter.unit == '1' else ', ' + parameter.unit}",
            fontsize=8,
        )


def _time(engine: DeckEngine) -> Any:
    which = int(engine.stations["which"][0])
    length = int(engine.stations["length"][0])
    return float(engine.shelf.extra["steps"][which].item()) * np.arange(1, length + 1)


def _shade(axes: Any, engine: DeckEngine) -> None:
    """Tint each true regime (the sea state), for the viewer only."""
    time, which = _time(engine), int(engine.stations["which"][0])
    regime = engine.shelf.tapes[which][: len(time)]["regime"]
    if not np.isfinite(regime).all():
        return
    ends = [*np.flatnonzero(np.diff(regime)) + 1, len(regime)]
    for first, last in zip([0, *ends[:-1]], ends, strict=True):
        colour = SHADES[int(regime[first]) % len(SHADES)]
        axes.axvspan(time[first], time[last - 1], color=colour, lw=0, zorder=0)


def _name_regimes(axes: Any, engine: DeckEngine) -> None:
    """Write each regime's name above its stretch."""
    names, time = engine.label(0).get("regimes"), _time(engine)
    regime = engine.shelf.tapes[int(engine.stations["which"][0])][: len(time)]["regime"]
    if not names or len(names) < 2 or not np.isfinite(regime).all():
        return
    ends = [*np.flatnonzero(np.diff(regime)) + 1, len(regime)]
    for first, last in zip([0, *ends[:-1]], ends, strict=True):
        middle = (time[first] + time[last - 1]) / 2.0 / time[-1]
        axes.text(
            middle, 0.02, names[int(regime[first])], transform=axes.transAxes, ha="center", fontsize=7,
            color=TRUTH,
        )  # fmt: skip


def _title(engine: DeckEngine) -> str:
    label, k = engine.label(0), int(engine.stations["k"][0])
    regime = engine.shelf.tapes[int(engine.stations["which"][0])]["regime"][max(k - 1, 0)]
    names = label.get("regimes")
    told = f", sea state: {names[int(regime)]}" if names and np.isfinite(regime) else ""
    return f"{label.get('scenario', 'recording')}, {_time(engine)[max(k - 1, 0)]:.0f} s{told}"
