"""`navgym train --kind mixture`: a mixture of fixed filters, from logs, in seconds."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from navgym.agents.mixture.training import Made, MixtureConfiguration, train
from navgym.command import as_typed
from navgym.tuning.commands.parse import configured, parse

ABOUT = """Train a mixture of fixed filters around tuned parameters, on real logs, in seconds.

    navgym train --kind mixture --log a.csv b.csv
    navgym train --kind mixture --log a.csv b.csv --start runs/tune/tuned.toml
    navgym train --kind mixture --log a.csv b.csv --validation-log c.csv --no-truth
    navgym train --kind mixture --log akit/GT_trajectory1.csv akit/GT_trajectory2.csv akit/GT_trajectory3.csv

The experts are the tuned filter, copies of it with other process noise and memory, a Kalman filter and the
bank; a linear softmax over what is seen of the samples weighs their states. Taught with the logs, with spoilt
copies of them (other noise, outliers, losses) and with simulated calm legs, by the truth where every log has
it, else by how well each fix is foretold one step ahead. Without --start the filter is tuned on the same logs
first, with the same information.

A guard judges it on logs that it was not trained on, by the one-step error of the fixes. Where it is not
better than the tuned parameters, what is written is those parameters, and it is said.

Writes mixture.npz, mixture.json and tuned.toml to --out. Next: navgym evaluate OUT/mixture --log other.csv,
navgym stream OUT/mixture < live.csv.
"""


def main(words: Sequence[str]) -> int:
    """Train; returns the exit status."""
    default, rest = configured(MixtureConfiguration, words)
    config = parse(MixtureConfiguration, "train --kind mixture", ABOUT, rest, default)
    made = train(config, command=as_typed("train", ["--kind", "mixture", *words]))
    print(summary(made))
    return 0


def summary(made: Made) -> str:
    """What was made, and what to do next."""
    path = made.folder / "mixture"
    lines = [f"made {path}.npz in {made.seconds:.0f} s, its start {made.folder / 'tuned.toml'}"]
    if made.mixture.refused:
        lines[0] = f"{path}.npz holds the tuned parameters alone: the guard said no"
    lines.append(f"next, on other logs: navgym evaluate {shlex.quote(str(path))} --log OTHER ...")
    return "\n".join(lines)
