"""Write the pages of docs/ that are read off the code: environments, filters, scenarios, training.

python scripts/build_docs.py           write them
python scripts/build_docs.py --check   say whether they are up to date (exit status 1 if not)
"""

from __future__ import annotations

import argparse
import inspect
import re
import sys
from pathlib import Path
from typing import Any

import gymnasium

from navgym.agents.mixture.training import MixtureConfiguration
from navgym.agents.training.configuration import markdown as configuration_table
from navgym.envs.settings import LaneSettings, argument_texts, signature
from navgym.problem import Filter, Problem, environments, problems
from navgym.simulation import find_scenario

DOCS = Path(__file__).resolve().parents[1] / "docs"
NOTE = "<!-- Written by scripts/build_docs.py: edit the code, not this page. -->\n\n"


def environment_page(name: str) -> str:
    """The manual of an environment: its class docstring, arguments as a table."""
    made: Any = gymnasium.make(name).unwrapped
    manual = inspect.getdoc(type(made)) or ""
    head, _, rest = manual.partition("Args:\n")
    tail = re.sub(r"\A(?: .*\n|\n)*", "\n", rest)
    table = "\n".join(_table(["argument", "default", "meaning"], _arguments(made.SETTINGS)))
    return f"{NOTE}# {name}\n\n{head}\n{table}\n{tail}\n"


def _arguments(kind: type[LaneSettings]) -> list[list[str]]:
    """Every argument of an environment: its default, and what it is for."""
    defaults = {name: p.default for name, p in signature(kind).parameters.items()}
    return [
        [f"`{name}`", f"`{defaults[name]!r}`", text] for name, text in argument_texts(kind).items()
    ]


def filters_page() -> str:
    """Every filter with its tunables."""
    parts = [
        NOTE + "# Filters\n",
        "`navgym.estimate(name, recording, parameters)` runs any of these on a recording of its problem; "
        "the numbers below are what `navgym.parameter_space(name)` holds.\n",
    ]
    for problem in problems():
        parts.append(f"## {problem.title}: filters of a `{problem.recording.__name__}`\n")
        parts += [_filter_part(f) for f in problem.filters.values()]
    return "\n".join(parts)


def _filter_part(chosen: Filter) -> str:
    table = chosen.space.markdown() if len(chosen.space) else "Nothing to tune."
    return f"### `{chosen.name}`\n\n{chosen.summary}\n\n{table}\n"


def scenarios_page() -> str:
    """Every scenario and every named shift."""
    parts = [
        NOTE + "# Scenarios\n",
        "`navgym.simulate(name, seed=..., **overrides)` makes a recording; any field can be "
        "overridden.",
    ]
    for problem in problems():
        parts += ["", *_scenarios_part(problem), "", *_shifts_part(problem)]
    return "\n".join(parts) + "\n"


def _scenarios_part(problem: Problem) -> list[str]:
    """The problem's scenarios, with what makes them long, and their regimes."""
    lengths = list(problem.brief)
    head = ["scenario", "what happens", *lengths, "regimes", "dwell"]
    rows = [
        [
            f"`{problem.full_name(s)}`",
            s.summary,
            *(f"{getattr(s, name):g}" for name in lengths),
            ", ".join(r.name for r in getattr(s, "regimes", ())),
            _dwell(s),
        ]
        for s in problem.scenarios.values()
    ]
    what = (
        f"Each makes a `{problem.recording.__name__}`; dwell is the time spent in a regime, in the unit of "
        f"{' and '.join(lengths)}."
    )
    return [f"## {problem.title}\n", f"{what}\n", *_table(head, rows)]


def _dwell(scenario: Any) -> str:
    """Least and largest time in a regime, where there are several."""
    if len(getattr(scenario, "regimes", ())) < 2:
        return ""
    return "-".join(dict.fromkeys(f"{end:g}" for end in scenario.dwell))


def _shifts_part(problem: Problem) -> list[str]:
    """What a study's usual scenario is changed to."""
    name = problem.study.scenario
    rows = [
        [shift, ", ".join(f"`{k}={_value(v)}`" for k, v in overrides.items())]
        for shift, overrides in problem.contest.shifts(find_scenario(name)).items()
    ]
    title = f"### Shifts: {problem.title}\n"
    return [
        title,
        f"Conditions that nothing was tuned on, of `{name}`.\n",
        *_table(["shift", "overrides"], rows),
    ]


def _value(value: Any) -> str:
    """A number or a few; what takes more room is left out."""
    if isinstance(value, float):
        return f"{value:g}"
    text = str(value)
    return text if len(text) < 30 else "…"


def _table(head: list[str], rows: list[list[str]]) -> list[str]:
    body = [f"| {' | '.join(row)} |" for row in rows]
    return [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}", *body]


def training_page() -> str:
    """Every field of a training's configuration."""
    return (
        NOTE + "# Fields of a training\n\n"
        "`navgym train --help` shows the same as flags (`decisions` is `--decisions`, "
        "`recipe.gamma` is `--recipe.gamma`); `config.toml` beside each policy holds them, and can be "
        f"given to the command again.\n\n{configuration_table()}\n\n"
        "## Of a mixture\n\n`navgym train --kind mixture --help` shows the same.\n\n"
        f"{configuration_table(MixtureConfiguration)}\n"
    )


def pages() -> dict[Path, str]:
    """Every page by its path."""
    found = {DOCS / "filters.md": filters_page(), DOCS / "scenarios.md": scenarios_page()}
    found[DOCS / "training.md"] = training_page()
    for name in sorted(environments()):
        found[DOCS / "environments" / f"{name.partition('/')[2]}.md"] = environment_page(name)
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
