"""What pictures of running environments are drawn on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

TRUTH, ESTIMATE, LOST = "#444444", "#0a6ebd", "#d1495b"
DPI = 100


class OneLane:
    """Lane i of an engine as if it were the only one: what a painter, who draws lane 0, is shown.

    Args:
        engine: with any number of lanes.
        lane: which.
    """

    def __init__(self, engine: Any, lane: int) -> None:
        self._engine, self._lane = engine, lane

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._engine, name)
        by_lane = name in ("stations", "lanes", "trail", "models", "believed")
        return found[self._lane : self._lane + 1] if by_lane else found

    def label(self, _: int) -> dict[str, Any]:
        """What the lane's recording is."""
        found: dict[str, Any] = self._engine.label(self._lane)
        return found


class Canvas:
    """A figure that is drawn anew for each picture, off screen ("rgb_array") or in a window ("human").

    Raises RuntimeError, with the remedy, if matplotlib is missing or no window can be opened.
    """

    def __init__(self, mode: str) -> None:
        self._mode = mode
        self._figure, self._canvas = _new_figure(mode)

    def draw(self, engine: Any, rows: Sequence[Sequence[float]]) -> None:
        """Draw lane 0 of `engine` and the parameters `rows` of its decisions on the empty figure."""
        raise NotImplementedError

    def paint(self, engine: Any, rows: Sequence[Sequence[float]]) -> NDArray[np.uint8] | None:
        """Draw lane 0 of `engine` and the parameters `rows` of its decisions so far.

        Returns (height, width, 3) bytes in mode "rgb_array".
        """
        self._figure.clear()
        self.draw(engine, rows)
        self._canvas.draw()
        if self._mode == "human":
            self._canvas.flush_events()
            return None
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._mode == "human":
            import matplotlib.pyplot as plt

            plt.close(self._figure)


def _new_figure(mode: str) -> tuple[Any, Any]:
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise RuntimeError("rendering needs matplotlib: pip install 'navgym[render]'.") from error
    if mode == "rgb_array":
        figure = Figure(figsize=(10, 6), dpi=DPI, layout="constrained")
        return figure, FigureCanvasAgg(figure)
    import matplotlib.pyplot as plt

    figure = plt.figure(figsize=(10, 6), dpi=DPI, layout="constrained")
    figure.show()
    return figure, figure.canvas
