"""How fast navgym is, as ratios to well-known things measured in the same run.

    python scripts/benchmark.py auv             print the table
    python scripts/benchmark.py deck
    python scripts/benchmark.py agents          learning, acting, live filters
    python scripts/benchmark.py studies         what Optuna and its storage cost
    python scripts/benchmark.py deck --write    also write docs/benchmarks-deck.md

Machines are noisy, so each pair is run in turns, and the median of the ratios is what counts. The
peers filterpy, fastrvm and (if it is installed: pip install dynamax) dynamax are optional.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from navgym.tuning.benchmarks.timing import Row

DOCS = Path(__file__).resolve().parents[1] / "docs"
TITLES = {"auv": "the AUV", "deck": "the deck", "agents": "agents", "studies": "studies"}


def main() -> None:
    """Parse the command line and measure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=list(TITLES), help="what to measure")
    parser.add_argument("--rounds", type=int, default=7, help="turns per pair (default: 7)")
    parser.add_argument("--write", action="store_true", help="write docs/benchmarks-PART.md")
    options = parser.parse_args()
    from navgym.tuning.benchmarks.timing import as_markdown

    rows = _part(options.part)(options.rounds)
    text = as_markdown(options.part, TITLES[options.part], rows)
    print(text)
    if options.write:
        (DOCS / f"benchmarks-{options.part}.md").write_text(text)


def _part(name: str) -> Callable[[int], list[Row]]:
    """What measures `name`; only its own packages are imported."""
    if name == "agents":
        from navgym.agents.benchmarks import agents

        return agents
    from navgym.tuning.benchmarks import auv, deck, studies

    return {"auv": auv.auv, "deck": deck.deck, "studies": studies.studies}[name]


if __name__ == "__main__":
    main()
