"""The AUV policy that is shipped where nobody trained it: shifts of the sea, and other parameters to start from.

    python scripts/policy_elsewhere.py                      the shipped policy, test seeds; tracks if NAVGYM_DATA is set
    python scripts/policy_elsewhere.py runs/mine/policy.npz --split validation --runs 40

Each row is 1 - its mean position RMSE over that of the parameters it starts from, alone and as it is
deployed, with 95 % intervals of pairs (over recordings; over tracks there are too few for one). Seas: those of
`navgym evaluate`, and what no scenario of the catalogue holds: manoeuvre and outliers at once, sinusoids,
quick cycles, R x300, correlated noise. Tracks 4-6 of A-KIT with the policy's own parameters, and with
parameters tuned on tracks 1-3 by the fixes and by the truth.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from navgym.agents import Policy
from navgym.agents.evaluation.rollout import Learnt, replay_filter, roll_out
from navgym.agents.evaluation.streamed import stream
from navgym.agents.policies.policy import located
from navgym.agents.training.logs import Logs
from navgym.agents.training.reference import tuned
from navgym.auv.problem import TRACKS
from navgym.auv.scenarios import SHIFTS, Regime
from navgym.core.checks import Array
from navgym.core.data import absent, data_folder
from navgym.core.seeds import seeds
from navgym.metrics import paired_difference
from navgym.simulation import simulate_many
from navgym.tuning.cases import Cases

SCENARIO = "auv/switch-D"
CALM = Regime("nominal")
BOTH = Regime("manoeuvre and outliers", process_scale=100.0, outlier_rate=0.2)
SEAS: Mapping[str, Mapping[str, Any]] = {
    "as trained": {},
    **SHIFTS,
    "manoeuvre and outliers at once": {"regimes": (CALM, BOTH)},
    "sinusoid .05 m/s², 60 s": {"regimes": (CALM,), "sway": (0.05, 60.0)},
    "sinusoid .3 m/s², 20 s": {"regimes": (CALM,), "sway": (0.3, 20.0)},
    "as trained, sinusoid .3 m/s², 20 s": {"sway": (0.3, 20.0)},
    "cycles of 10-20 samples": {"dwell": (10, 20)},
    "R x300": {"measurement_scale": 300.0},
    "noise AR(.5)": {"memory": 0.5},
    "noise AR(.9)": {"memory": 0.9},
}
TRIALS = 150
DRAWS = 10  # of noise and losses per track and rate


def row(label: str, policy: Policy, cases: Cases) -> str:
    """One line: what the policy gains over the parameters that it starts from."""
    chooser, name = Learnt(policy), policy.manifest.filter
    base = cases.true_errors(cases.problem.run(name, cases.batch, dict(policy.manifest.reference)))
    found = roll_out(chooser, cases.recordings)
    run = cases.problem.run(replay_filter(chooser), cases.batch, found.schedules, found.interval)
    states, shares = stream(policy, cases.recordings, cases.batch.steps)
    quantity = cases.first_quantity
    live = cases.problem.scoring.errors(cases.batch, states, (quantity,), cases.span)[quantity]
    told = [_gain(errors, base) for errors in (cases.true_errors(run), live)]
    return f"{label:44} {base.mean():7.3f}  {told[0]:>26}  {told[1]:>26}  {shares.mean():5.0%}"


def _gain(errors: Array, base: Array) -> str:
    if not np.isfinite(errors).all():
        return "diverges"
    d = paired_difference(errors, base)
    return f"{100 * d.relative_gain:+.1f} % ({100 * d.gain_low:+.1f} to {100 * d.gain_high:+.1f})"


def seas(policy: Policy, split: str, runs: int) -> Iterator[str]:
    """The policy around its own parameters under each condition."""
    for label, overrides in SEAS.items():
        made = simulate_many(SCENARIO, seeds(split, runs), **overrides)
        yield row(label, policy, Cases.of(made))


def tracks(policy: Policy, folder: Path, split: str) -> Iterator[str]:
    """The policy on the second half of the tracks, around its own and around tuned parameters."""
    first, last = (
        Logs(tuple(folder / f"GT_trajectory{t}.csv" for t in fold)) for fold in TRACKS.folds
    )
    around = {"own": policy}
    for measure in ("fixes", "rmse"):
        parameters = tuned(first, policy.manifest.filter, measure, TRIALS)
        around[f"tuned by {measure}"] = policy.with_reference(parameters)
    for label, each in around.items():
        for rate, cases in last.by_rate(split, DRAWS).items():
            yield row(f"tracks 4-6, {rate}, {label}", each, cases)


def main() -> None:
    """Print a line per condition."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("policy", nargs="?", default="auv", help="file of a policy, or auv (the default)")
    add("--split", choices=("validation", "test"), default="test", help="whose seeds (%(default)s)")
    add("--runs", type=int, default=200, help="recordings per sea (%(default)s)")
    add("--data", type=Path, help="folder of the A-KIT tracks; by default that in $NAVGYM_DATA")
    options = parser.parse_args()
    policy = Policy.load(located(options.policy))
    heads = ("", "start, m", "the policy alone", "as deployed", "fallback")
    print(f"{heads[0]:44} {heads[1]:>7} {heads[2]:>27}  {heads[3]:>26}  {heads[4]}", flush=True)
    for line in seas(policy, options.split, options.runs):
        print(line, flush=True)
    folder = data_folder(TRACKS.name, options.data)
    if folder is None:
        print(absent(TRACKS.title))
    else:
        for line in tracks(policy, folder, options.split):
            print(line, flush=True)
    print(f"load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
