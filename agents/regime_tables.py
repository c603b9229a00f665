"""Parameters by true regime, per scenario: what a schedule can win that knows what nobody tells.

    python -m agents.regime_tables              tune the AUV tables anew and print them, 3 minutes

The regime is truth, so a table is a bound and no filter. It stands beside every policy; a policy can
also be taught by it.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from navgym.simulation import find_scenario

TRIALS = 300

_SCHEDULED = ("forgetting", "process_noise_scale")
# From `python -m agents.regime_tables`: tuned on 40 training recordings from the best fixed parameters,
# the best of the leaders on 40 validation recordings; forgetting, process_noise_scale.
_AUV: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "switch-A": {
        "calm": (0.932, 0.78), "noisy": (0.967, 1.5), "outlier": (0.72, 6.8), "burst": (0.89, 2.5),
    },
    "switch-B": {
        "calm": (0.86, 1.3), "noisy": (0.965, 1.3), "outlier": (0.78, 12.0), "burst": (0.85, 1.3),
        "manoeuvre": (0.89, 70.0),
    },
    "switch-D": {"nominal": (0.915, 1.1), "outlier": (0.79, 10.0), "manoeuvre": (0.88, 120.0)},
    "tvr": {"calm": (0.83, 2.8), "noisy": (0.9987, 1.1)},
}  # fmt: skip
# The correntropy criterion against glitches, and off elsewhere (SCIENCE B3).
_WIDTHS = {"calm": 50.0, "swell": 50.0, "slam": 50.0, "glitch": 2.0}
_DECK = ("switch-60", "switch-30", "switch-gyro")

TABLES: Mapping[str, Mapping[str, Mapping[str, float]]] = MappingProxyType(
    {
        f"auv/{name}": {g: dict(zip(_SCHEDULED, row, strict=True)) for g, row in table.items()}
        for name, table in _AUV.items()
    }
    | {f"deck/{n}": {g: {"kernel_width": w} for g, w in _WIDTHS.items()} for n in _DECK}
)


def rows_by_regime(scenario: str, regimes: Sequence[str]) -> dict[str, list[float]]:
    """The scheduled parameters of `scenario`, each as one value per name of `regimes`, in order.

    Raises ValueError for a scenario without a table, or a regime that its table lacks.
    """
    table = TABLES.get(scenario)
    if table is None:
        raise ValueError(
            f"there is no table by true regime for {scenario!r}: known for {', '.join(TABLES)}."
        )
    missing = [name for name in regimes if name not in table]
    if missing:
        raise ValueError(
            f"the table of {scenario} holds the regimes {', '.join(table)}, and the recordings have "
            f"{missing[0]!r}."
        )
    names = next(iter(table.values()))
    return {name: [table[g][name] for g in regimes] for name in names}


def tuned(name: str, trials: int = TRIALS) -> tuple[dict[str, Any], float]:
    """Tune the table of AUV scenario `name`; returns it and its error on validation seeds, m."""
    from tuning.experiments import regime_table
    from tuning.selection import rounded

    start = dict(find_scenario(f"auv/{name}").reference)
    goal, best = regime_table(f"auv/{name}", start, trials)
    return rounded(goal.space, best.values), best.result


def main() -> int:
    """Tune and print every AUV table."""
    for name in _AUV:
        found, error = tuned(name)
        print(f"auv/{name}: {error:.4f} m on validation seeds")
        for parameter, value in found.items():
            print(f"    {parameter:40} {value:g}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
