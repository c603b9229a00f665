"""What agents are worth on real tracks that nothing was tuned or trained on: A-KIT, tracks 1 to 6.

    python scripts/agents_on_tracks.py                         every part; needs the data in $NAVGYM_DATA
    python scripts/agents_on_tracks.py --part halves blind     some of them
    python scripts/agents_on_tracks.py --part policy --seeds 1 --pairs 3

Agents start from parameters that were tuned on the same tracks with the same information, and are measured
against those. Noise and losses: training seeds to tune and train on, validation seeds to choose, test seeds
to report. Parts:

halves   the mixture trained on tracks 1-3, reported on 4-6, by the truth; other tracks with 5 % of outliers
blind    the same without any truth: tuned, trained and judged by the fixes; beside tuned by likelihood
aligned  both on tracks whose delay and lever arm are taken out
pairs    the mixture trained on four tracks, reported on the other two: all 15 pairs
policy   PPO likewise, 3 pairs that share no track, or more
retune   settings chosen per recording afterwards, by its own fixes

Intervals resample tracks. Writes NAME.json of each part to --out, and what was tuned on the way, which
is not tuned again.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from navgym.agents.evaluation.on_logs import gain, of_fixed, of_policy
from navgym.agents.mixture.experts import Expert
from navgym.agents.mixture.retune import retuned, settings_around
from navgym.agents.mixture.training import Made, MixtureConfiguration, train
from navgym.agents.training.logs import Logs
from navgym.agents.training.reference import tuned
from navgym.auv.problem import TRACKS
from navgym.core.atomic import possible_folder, replacing
from navgym.core.data import absent, data_folder
from navgym.problem import Run
from navgym.tuned import read_tuned
from navgym.tuning.cases import Cases
from navgym.tuning.declared import to_toml

NUMBERS = (1, 2, 3, 4, 5, 6)
FIRST, LAST = (1, 2, 3), (4, 5, 6)
DRAWS = 10  # of noise and losses per track and rate, to report on
OUTLIERS, SIZE = 0.05, 30.0  # share of fixes, m
ALIGNED = ("align", "true")
Rows = list[dict[str, Any]]


class Bench:
    """Where tracks are, how many trials and seeds, and what was tuned so far.

    Args:
        folder: of the A-KIT data.
        options: of the command line.
    """

    def __init__(self, folder: Path, options: argparse.Namespace) -> None:
        self.folder, self.options = folder, options
        self.scratch = Path(tempfile.mkdtemp())

    def logs(self, tracks: Sequence[int], words: Sequence[str] = ()) -> Logs:
        """Some tracks as logs."""
        paths = tuple(self.folder / f"GT_trajectory{t}.csv" for t in tracks)
        return Logs(paths, tuple(words))

    def start(self, logs: Logs, measure: str) -> Path:
        """A tuned.toml of these logs by that measure, tuned once for all calls that write to one folder."""
        tracks = "".join(p.stem[-1] for p in logs.paths)
        told = [measure, tracks, *logs.words, str(self.options.trials)]
        path: Path = self.options.out / f"tuned-{'-'.join(told)}.toml"
        if not path.is_file():
            values = tuned(logs, "qivbf", measure, self.options.trials)
            with replacing(path, text=True) as file:
                file.write(to_toml({"filter": "qivbf", "parameters": values}))
        return path

    def mixture(self, logs: Logs, measure: str, truth: bool, seed: int) -> Made:
        """A mixture trained on logs."""
        config = MixtureConfiguration(
            log=logs.paths, read=logs.words, start=self.start(logs, measure), truth=truth, seed=seed,
            out=self.scratch / "mixture",
        )  # fmt: skip
        return train(config, report=lambda _: None)


def report_on(logs: Logs, told: Callable[[Cases], dict[str, Run]], **about: Any) -> Rows:
    """A row per rate of losses, contender and track: mean error over the draws."""
    rows = []
    for rate, cases in logs.by_rate("test", DRAWS).items():
        names = [r.meta["log"] for r in cases.recordings]
        for label, run in told(cases).items():
            errors = cases.true_errors(run)
            for name in dict.fromkeys(names):
                mine = [e for e, n in zip(errors, names, strict=True) if n == name]
                rows.append({**about, "rate": rate, "who": label, "track": name, "rmse": float(np.mean(mine))})  # fmt: skip
    return rows


def contenders(made: Made, *more: Path) -> Callable[[Cases], dict[str, Run]]:
    """The mixture, as guarded and as trained, its tuned parameters, others' and what needs none."""

    def told(cases: Cases) -> dict[str, Run]:
        run = cases.problem.run
        found = {n: run(n, cases.batch) for n in ("kf", "bank")}
        for path in more:
            found["likelihood"] = run("qivbf", cases.batch, dict(read_tuned(path).parameters))
        found["tuned"] = run("qivbf", cases.batch, dict(made.start.parameters))
        found["agent"] = made.mixture.run(cases.batch)
        found["unguarded"] = made.tried.run(cases.batch)
        return found

    return told


def spoilt(cases: Cases) -> Cases:
    """The same with outliers among the fixes."""
    rng = np.random.default_rng(np.random.SeedSequence([0x51, 1]))
    found = []
    for r in cases.recordings:
        y = r.measurements.copy()
        hit, way = rng.random(len(y)) < OUTLIERS, rng.uniform(0.0, 2.0 * np.pi, len(y))
        y[:, [0, 2]] += SIZE * hit[:, None] * np.stack([np.cos(way), np.sin(way)], axis=1)
        found.append(replace(r, measurements=y))
    return Cases.of(found, cases.about)


def halves(
    bench: Bench, truth: bool = True, words: Sequence[str] = (), part: str = "halves"
) -> Rows:
    """Trained on tracks 1-3, reported on 4-6, and there with outliers."""
    rows: Rows = []
    own, other = bench.logs(FIRST, words), bench.logs(LAST, words)
    measure = "rmse" if truth else "fixes"
    likelihood = [] if truth else [bench.start(own, "likelihood")]
    for seed in range(bench.options.seeds):
        made = bench.mixture(own, measure, truth, seed)
        who = contenders(made, *likelihood)
        about = {"seed": seed, "guard": made.verdict.gain, "seconds": made.seconds}
        rows += report_on(other, who, part=part, **about)
        rows += report_on(other, lambda c, w=who: w(spoilt(c)), part=f"{part}, outliers", **about)
    return rows


def blind(bench: Bench) -> Rows:
    """The same without any truth."""
    return halves(bench, truth=False, part="blind")


def aligned(bench: Bench) -> Rows:
    """Both on time-corrected tracks."""
    return halves(bench, True, ALIGNED, "aligned") + halves(bench, False, ALIGNED, "aligned, blind")


def pairs_of(count: int) -> list[tuple[int, int]]:
    """All 15 pairs of tracks, or the first of them, those that share no track before all others."""
    apart = [(1, 2), (3, 4), (5, 6)]
    rest = [p for p in itertools.combinations(NUMBERS, 2) if p not in apart]
    return [*apart, *rest][:count]


def pairs(bench: Bench) -> Rows:
    """Leave two out: the mixture."""
    rows: Rows = []
    for pair in pairs_of(bench.options.pairs or 15):
        own = bench.logs([t for t in NUMBERS if t not in pair])
        for seed in range(bench.options.seeds if pair in pairs_of(3) else 1):
            made = bench.mixture(own, "rmse", True, seed)
            about = {"pair": list(pair), "seed": seed, "guard": made.verdict.gain}
            rows += report_on(bench.logs(pair), contenders(made), part="pairs", **about)
        print(pair, made.verdict, f"{made.seconds:.0f} s", flush=True)
    return rows


def policy(bench: Bench) -> Rows:
    """Leave two out: PPO."""
    from navgym.agents.training.configuration import presets
    from navgym.agents.training.run import train as train_policy

    rows: Rows = []
    usual = presets()["auv-logs"][1]
    for pair in pairs_of(bench.options.pairs or 3):
        own = bench.logs([t for t in NUMBERS if t not in pair])
        start = bench.start(own, "rmse")
        for seed in range(bench.options.seeds):
            config = replace(
                usual, log=own.paths, start=start, seed=seed, out=bench.scratch / "policy"
            )
            made = train_policy(config, fresh=True, report=lambda _: None).policy
            assert made is not None
            reference = dict(made.manifest.reference)

            def told(cases: Cases, made: Any = made, reference: Any = reference) -> dict[str, Run]:
                return {
                    "tuned": of_fixed("qivbf", reference)(cases),
                    "agent": of_policy(made)(cases),
                }

            guard = made.manifest.training["guard"]["gain"]
            rows += report_on(bench.logs(pair), told, part="policy", pair=list(pair), seed=seed, guard=guard)  # fmt: skip
            print(pair, seed, f"guard {100 * guard:+.2f} %", flush=True)
    return rows


def retune(bench: Bench) -> Rows:
    """A table of settings around those tuned on 1-3; each recording of 4-6 picks by its own fixes."""
    start = read_tuned(bench.start(bench.logs(FIRST), "fixes"))
    table = settings_around(Expert(start.filter, dict(start.parameters)))
    rows = []
    for rate, cases in bench.logs(LAST).by_rate("test", DRAWS).items():
        made = retuned(cases, table)
        errors, picked = made.truth, made.which
        assert errors is not None
        found = {"tuned": errors[0], "agent": errors[picked, np.arange(len(picked))], "best afterwards": errors.min(axis=0)}  # fmt: skip
        names = [r.meta["log"] for r in cases.recordings]
        for label, each in found.items():
            for name in dict.fromkeys(names):
                mine = [e for e, n in zip(each, names, strict=True) if n == name]
                rows.append({"part": "retune", "rate": rate, "who": label, "track": name, "rmse": float(np.mean(mine))})  # fmt: skip
    return rows


PARTS: dict[str, Callable[[Bench], Rows]] = {
    "halves": halves, "blind": blind, "aligned": aligned, "pairs": pairs, "policy": policy, "retune": retune,
}  # fmt: skip


# ---- what it comes to


def summary(rows: Rows) -> str:
    """Errors by part, rate and contender, and gains over the tuned parameters."""
    lines = []
    for part in dict.fromkeys(r["part"] for r in rows):
        mine = [r for r in rows if r["part"] == part]
        for rate in dict.fromkeys(r["rate"] for r in mine):
            here = [r for r in mine if r["rate"] == rate]
            names = dict.fromkeys(r["who"] for r in here)
            lines += [f"{part:16} {rate:10} {who:15} {_line(here, who)}" for who in names]
    return "\n".join(lines)


def _line(rows: Rows, who: str) -> str:
    """Mean error; of what was made from tuned parameters its gain, by track and by seed."""
    own = [r for r in rows if r["who"] == who]
    text = f"{np.mean([r['rmse'] for r in own]):.3f}"
    if who == "tuned" or not any(r["who"] == "tuned" for r in rows):
        return text
    base = [r for r in rows if r["who"] == "tuned"]
    tracks = dict.fromkeys(r["track"] for r in own)
    errors, against = (
        np.array([np.mean([r["rmse"] for r in each if r["track"] == t]) for t in tracks])
        for each in (own, base)
    )
    g = gain(errors, against)
    text += f"  {100 * g.mean:+.1f} %, worst track {100 * g.worst:+.1f} %"
    if np.isfinite(g.low):
        text += f" (tracks resampled: {100 * g.low:+.1f} to {100 * g.high:+.1f})"
    seeds = [_gain_of(own, base, "seed", s) for s in dict.fromkeys(r.get("seed") for r in own)]
    text += f"; seeds {', '.join(f'{100 * s:+.1f}' for s in seeds)}" if len(seeds) > 1 else ""
    if "pair" in own[0]:
        each = [_gain_of(own, base, "pair", p) for p in _distinct([r["pair"] for r in own])]
        text += f"; worst of {len(each)} pairs {100 * min(each):+.1f} %"
    return text


def _distinct(values: Sequence[Any]) -> list[Any]:
    return [v for i, v in enumerate(values) if v not in values[:i]]


def _gain_of(own: Rows, base: Rows, name: str, value: Any) -> float:
    mine, against = ([r["rmse"] for r in each if r.get(name) == value] for each in (own, base))
    return float(1.0 - np.mean(mine) / np.mean(against))


def parsed() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--part", nargs="+", choices=PARTS, default=list(PARTS), help="which (all)")
    add("--seeds", type=int, default=3, help="trainings of each agent (%(default)s)")
    add("--pairs", type=int, help="pairs of tracks to leave out (15 of mixtures, 3 of policies)")
    add("--trials", type=int, default=150, help="of each tuning (%(default)s)")
    add("--data", type=Path, help="folder of the A-KIT tracks; by default that in $NAVGYM_DATA")
    add(
        "--out",
        type=Path,
        default=Path("runs/agents-on-tracks"),
        help="folder of results (%(default)s)",
    )
    return parser.parse_args()


def main() -> None:
    """Run the parts, each into a file of its own."""
    options = parsed()
    folder = data_folder(TRACKS.name, options.data)
    if folder is None:
        raise SystemExit(absent(TRACKS.title))
    possible_folder("--out", options.out)
    options.out.mkdir(parents=True, exist_ok=True)
    bench = Bench(folder, options)
    for part in options.part:
        began = time.perf_counter()
        rows = PARTS[part](bench)
        facts = {"seconds": time.perf_counter() - began, "load": os.getloadavg()[0], "rows": rows}
        with replacing(options.out / f"{part}.json", text=True) as file:
            file.write(json.dumps(facts, indent=1) + "\n")
        print(summary(rows), f"\n{part}: {facts['seconds']:.0f} s at load {facts['load']:.1f}\n", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
