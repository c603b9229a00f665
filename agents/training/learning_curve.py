"""The learning curve of a training, as a page of its own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from navgym.agents.training.configuration import Configuration
from navgym.agents.training.record import Mark


def write_curve(
    path: Path, config: Configuration, history: Sequence[Mark], best: Mark
) -> Path | None:
    """Draw gains over best fixed parameters against decisions; None without matplotlib or jinja2."""
    try:
        from navgym.tuning.report.page import Page, Section, Tile, write_page
        from navgym.tuning.report.plots import BEST, MORE, OWN, PLAIN, drawing
    except ModuleNotFoundError:
        return None
    decisions = np.array([mark.decisions for mark in history]) / 1000.0
    first = next(iter(best.scores["gains"]))
    caption = (
        "Gain over best fixed parameters on validation recordings as training goes on; the band is "
        f"the 95 % interval of {first}. The policy with the best score is kept."
    )
    with drawing(caption, 3.6) as (axes, made):
        colors, drawn = iter((OWN, PLAIN, *MORE) * 3), []
        for arena, quantities in best.scores["gains"].items():
            for name in quantities:
                gains = [100 * mark.scores["gains"][arena][name] for mark in history]
                drawn.append(gains)
                axes.plot(decisions, gains, color=next(colors), lw=1.6, label=f"{arena}: {name}")
        first_name = next(iter(best.scores["gains"][first]))
        middle = np.array([100 * m.scores["gains"][first][first_name] for m in history])
        half = np.array([100 * m.scores["half"] for m in history])
        axes.fill_between(decisions, middle - half, middle + half, color=OWN, alpha=0.2, lw=0)
        axes.axvline(best.decisions / 1000.0, color=BEST, lw=1.2, ls=(0, (4, 3)), label="kept")
        top, bottom = np.max(drawn), np.min(drawn)
        axes.set_ylim(max(bottom, -0.3 * top - 5.0) - 2.0, top + 2.0)  # a wild start is cut
        axes.set_xlabel("decisions, thousands")
        axes.set_ylabel("gain, %")
        axes.grid(axis="y")
        axes.legend(loc="lower right", fontsize=9)
    gain = next(iter(best.scores["gains"][first].values()))
    page = Page(
        title=f"Training of a policy for {', '.join(config.scenarios)}",
        lede=[
            f"`{config.algorithm}`, seed {config.seed}, {history[-1].decisions} decisions in "
            f"{history[-1].seconds:.0f} s. Figures are of validation recordings, which chose the "
            "policy: report those of `navgym evaluate`, which are of fresh ones."
        ],
        tiles=[Tile(f"{100 * gain:.1f} %", f"below best fixed parameters on {first}", "own")],
        sections=[Section("Learning curve", items=[made[0]])],
        provenance={"configuration": config.as_dict()},
    )
    return write_page(path, page)
