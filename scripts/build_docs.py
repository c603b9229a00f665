"""Write the pages of docs/ that are read off the code: environments, filters, scenarios, training.

python scripts/build_docs.py           write them
python scripts/build_docs.py --check   say whether they are up to date (exit status 1 if not)
"""

from __future__ import annotations

import argparse
import inspect
import sys
from pathlib import Path

import gymnasium

from agents.configuration import markdown as configuration_table
from navgym.filters.catalogue import CATALOGUE as CATALOGUE_OF_FILTERS
from navgym.filters.catalogue import DECK_CATALOGUE as DECK_FILTERS
from navgym.filters.catalogue import Filter
from navgym.scenarios import CATALOGUE, DECK_CATALOGUE, SHIFTS

DOCS = Path(__file__).resolve().parents[1] / "docs"
NOTE = "<!-- Written by scripts/build_docs.py: edit the code, not this page. -->\n\n"


def environment_page(name: str) -> str:
    """The manual of an environment: its class docstring."""
    manual = inspect.getdoc(type(gymnasium.make(name).unwrapped)) or ""
    return f"{NOTE}# {name}\n\n{manual}\n"


def filters_page() -> str:
    """Every filter with its tunables."""
    parts = [
        NOTE + "# Filters\n",
        "`navgym.estimate(name, recording, parameters)` runs any of these; the numbers below are "
        "what `navgym.parameter_space(name)` holds. The second half takes recordings of two IMUs.\n",
    ]
    parts += [_filter_part(f) for f in CATALOGUE_OF_FILTERS.values()]
    parts.append("# Filters of the deck\n")
    parts += [_filter_part(f) for f in DECK_FILTERS.values()]
    return "\n".join(parts)


def _filter_part(chosen: Filter) -> str:
    table = chosen.space.markdown() if len(chosen.space) else "Nothing to tune."
    return f"## `{chosen.name}`\n\n{chosen.summary}\n\n{table}\n"


def scenarios_page() -> str:
    """Every scenario and every named shift."""
    parts = [
        NOTE + "# Scenarios\n",
        "`navgym.simulate(name, seed=..., **overrides)` makes a recording; any field can be "
        "overridden.\n",
        "| scenario | what happens | samples | regimes |",
        "|---|---|---|---|",
    ]
    parts += [
        f"| `auv/{s.name}` | {s.summary} | {s.steps} | {', '.join(r.name for r in s.regimes)} |"
        for s in CATALOGUE.values()
    ]
    parts += [
        "\n## Deck\n",
        "A `DualIMURecording`; times in seconds, dwell being the time in a regime.\n",
        "| scenario | what happens | duration | regimes | dwell |",
        "|---|---|---|---|---|",
    ]
    parts += [
        f"| `deck/{s.name}` | {s.summary} | {s.duration:g} | {', '.join(r.name for r in s.regimes)} | "
        f"{s.dwell[0]:g} |"
        for s in DECK_CATALOGUE.values()
    ]
    parts += [
        "\n## Shifts\n",
        "Conditions that nothing was tuned on.\n",
        "| shift | overrides |",
        "|---|---|",
    ]
    parts += [
        f"| {name} | {', '.join(f'`{k}={v:g}`' if isinstance(v, float) else f'`{k}={v}`' for k, v in o.items())} |"
        for name, o in SHIFTS.items()
    ]
    return "\n".join(parts) + "\n"


def training_page() -> str:
    """Every field of a training's configuration."""
    return (
        NOTE + "# Fields of a training\n\n"
        "`python scripts/train.py --help` shows the same as flags (`decisions` is `--decisions`, "
        "`recipe.gamma` is `--recipe.gamma`); `config.toml` beside each policy holds them, and can be "
        f"given to the command again.\n\n{configuration_table()}\n"
    )


def pages() -> dict[Path, str]:
    """Every page by its path."""
    found = {DOCS / "filters.md": filters_page(), DOCS / "scenarios.md": scenarios_page()}
    found[DOCS / "training.md"] = training_page()
    for name in sorted(gymnasium.registry):
        if name.startswith("navgym/"):
            found[DOCS / "environments" / f"{name.removeprefix('navgym/')}.md"] = environment_page(
                name
            )
    return found


def main() -> int:
    """Parse the command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="write nothing, compare only")
    check = parser.parse_args().check
    stale = []
    for path, text in pages().items():
        if check:
            if not path.is_file() or path.read_text() != text:
                stale.append(path.name)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
    if stale:
        print(f"out of date: {', '.join(stale)}: run python scripts/build_docs.py")
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
