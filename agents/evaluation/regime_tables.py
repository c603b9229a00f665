"""Parameters by true regime, per scenario: what a schedule can win that knows what nobody tells.

    python -m navgym.agents.evaluation.regime_tables              tune the first problem's tables anew, 3 minutes
    python -m navgym.agents.evaluation.regime_tables PROBLEM ...  those of the problems named

The regime is truth, so a table is a bound and no filter. It stands beside every policy; a policy can
also be taught by it.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from navgym.core.checks import one_of
from navgym.problem import PROBLEMS, problems
from navgym.simulation import find_scenario

TRIALS = 300

ByRegime = Mapping[str, Mapping[str, float]]  # regime to values by name


def tables() -> dict[str, ByRegime]:
    """Every table there is, by the scenario's full name."""
    return {
        f"{problem.name}/{scenario}": table
        for problem in problems()
        for scenario, table in problem.study.tables.items()
    }


def rows_by_regime(scenario: str, regimes: Sequence[str]) -> dict[str, list[float]]:
    """The scheduled parameters of `scenario`, each as one value per name of `regimes`, in order.

    Raises ValueError for a scenario without a table, or a regime that its table lacks.
    """
    known = tables()
    table = known.get(scenario)
    if table is None:
        raise ValueError(
            f"there is no table by true regime for {scenario!r}: known for {', '.join(known)}."
        )
    missing = [name for name in regimes if name not in table]
    if missing:
        raise ValueError(
            f"the table of {scenario} holds the regimes {', '.join(table)}, and the recordings have "
            f"{missing[0]!r}."
        )
    names = next(iter(table.values()))
    return {name: [table[g][name] for g in regimes] for name in names}


def tuned(scenario: str, trials: int = TRIALS) -> tuple[dict[str, Any], float]:
    """Tune the table of a scenario, by its full name; returns it and its error on validation seeds."""
    from navgym.tuning.experiments import regime_table
    from navgym.tuning.study.selection import rounded

    goal, best = regime_table(scenario, dict(find_scenario(scenario).reference), trials)
    return rounded(goal.space, best.values), best.result


def main(words: Sequence[str] | None = None) -> int:
    """Tune and print the tables of the problems that are named."""
    names = tuple(sys.argv[1:] if words is None else words) or tuple(PROBLEMS)[:1]
    for problem in [PROBLEMS[one_of("problem", name, PROBLEMS)] for name in names]:
        unit = next(iter(problem.scoring.quantities.values())).unit
        for own in problem.study.tables:
            scenario = f"{problem.name}/{own}"
            found, error = tuned(scenario)
            print(f"{scenario}: {error:.4f} {unit} on validation seeds")
            for parameter, value in found.items():
                print(f"    {parameter:40} {value:g}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
