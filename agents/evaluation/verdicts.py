"""Is a policy better than the simpler ways, and where? Paired, on recordings that nothing was tuned on."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
from tqdm import tqdm

from navgym.agents.combiner.combiner import KIND as COMBINER_KIND
from navgym.agents.combiner.combiner import Combiner
from navgym.agents.evaluation.contest import (
    BEST_FIXED,
    FALLBACK,
    HAND_RULE,
    OWN,
    SHIFT,
    Condition,
    Extent,
    Result,
    short,
)
from navgym.agents.evaluation.league import League
from navgym.agents.evaluation.play import Part, joined, parts, play
from navgym.agents.evaluation.rollout import problem_in
from navgym.agents.mixture.mixture import KIND as MIXTURE_KIND
from navgym.agents.mixture.mixture import Mixture
from navgym.agents.policies.loading import kind_of
from navgym.agents.policies.policy import KIND, PRETRAINED, Policy
from navgym.agents.policies.portable import pair
from navgym.core.checks import one_of, positive_int
from navgym.core.data import data_folder
from navgym.metrics import PairedDifference, holm
from navgym.problem import Tracks, environments, problem_of
from navgym.simulation import find_scenario
from navgym.simulation import scenarios as known_scenarios
from navgym.tuning.comparison import Comparison
from navgym.tuning.study.executors import workers

COMBINED = "bank + combiner"
LEVEL = 0.05  # of the tests, several policies together
PRICE = 0.02  # by how much another quantity may grow


@dataclass(frozen=True)
class Verdict:
    """One policy in one condition that it was trained for.

    Args:
        policy: its label.
        condition: name of the condition.
        gain: 1 − its mean error / that of the best fixed parameters, with the interval's ends.
        low: see `gain`.
        high: see `gain`.
        p_value: of "no different from them", as it is.
        p_holm: adjusted for as many policies as were tried there.
        score: 0 for the plain filter, 1 for the bound.
        better: whether it is better than the best fixed parameters, beyond doubt.
        prices: what it is better at the price of: quantities that grew by more than `PRICE`.
        ahead: filters and rules that learnt nothing, and beat it.
        losses: shifted conditions where it is worse than the best fixed parameters, beyond doubt.
        rescued: of `losses`, those where its fallback is not.
    """

    policy: str
    condition: str
    gain: float
    low: float
    high: float
    p_value: float
    p_holm: float
    score: float
    better: bool
    prices: tuple[str, ...]
    ahead: tuple[str, ...]
    losses: tuple[str, ...]
    rescued: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Bench:
    """All contests of one environment.

    Args:
        league: who took part.
        results: per condition, the own ones first.
        verdicts: per policy and condition that it was trained for.
    """

    league: League
    results: tuple[Result, ...]
    verdicts: tuple[Verdict, ...]

    def own(self) -> Iterator[Result]:
        """Results of the conditions that policies are judged in."""
        return (r for r in self.results if r.condition.kind == OWN)

    def find(self, condition: str) -> Result:
        """The result of the own condition called `condition`."""
        return next(r for r in self.own() if r.condition.name == condition)

    def shifts(self, base: str) -> list[Result]:
        """Results of the shifts of an own condition."""
        return [r for r in self.results if r.condition.base == base]

    def rest(self) -> list[Result]:
        """Results of conditions that are nobody's own, nor shifts of those."""
        return [r for r in self.results if r.condition.kind not in (OWN, SHIFT)]


# ---- who and where


def load(paths: Sequence[Path]) -> dict[str, Policy]:
    """Policies by label: the shipped ones if no path is given.

    Raises:
        FileNotFoundError: no such file.
        ValueError: a truncated or foreign file, or no policy at all.
    """
    if not paths:
        paths = shipped()
    labels = [_label(pair(p)[0]) for p in paths]
    if len(set(labels)) < len(labels):
        labels = [f"{pair(p)[0].parent.name}/{pair(p)[0].stem}" for p in paths]
    twice = [name for name in labels if labels.count(name) > 1]
    if twice:
        raise ValueError(f"policies must have distinct names, got {twice[0]!r} twice.")
    return {label: Policy.load(p) for label, p in zip(labels, paths, strict=True)}


def _label(path: Path) -> str:
    """A policy's or mixture's name: of its file, or of its folder where the file is called just that."""
    alone = path.stem in ("policy", "mixture")
    return path.resolve().parent.name if alone else path.stem


def shipped() -> list[Path]:
    """Files of the policies that come with the project."""
    found = [p for p in sorted(PRETRAINED.glob("*.json")) if _kind(p) == KIND]
    if not found:
        raise ValueError(
            "agents/pretrained holds no policy: name one, or train one with navgym train."
        )
    return found


def _kind(path: Path) -> str:
    """What a file of the portable format says it is."""
    return str(json.loads(path.read_text(encoding="utf-8")).get("kind"))


def load_combiners(paths: Sequence[Path]) -> dict[str, Combiner | Mixture]:
    """Combiners and mixtures by label: the shipped combiner, if there is one, where none is named.

    Raises:
        FileNotFoundError: no such file.
        ValueError: a truncated or foreign file, or one of another bank; two of one name.
    """
    mixtures = [p for p in paths if kind_of(p) == MIXTURE_KIND]
    others = [p for p in paths if p not in mixtures]
    if not others:
        there = sorted(PRETRAINED.glob("*.json"))
        others = [p for p in there if _kind(p) == COMBINER_KIND][:1]
    labels = [COMBINED] if len(others) == 1 else [f"bank + {_label(pair(p)[0])}" for p in others]
    found: dict[str, Combiner | Mixture] = {
        label: Combiner.load(p) for label, p in zip(labels, others, strict=True)
    }
    for path in mixtures:
        label = f"mixture {_label(pair(path)[0])}"
        if label in found:
            raise ValueError(f"mixtures must have distinct names, got {label!r} twice.")
        found[label] = Mixture.load(path)
    return found


def leagues(
    policies: Mapping[str, Policy],
    extent: Extent,
    scenarios: Sequence[str] = (),
    folder: Path | None = None,
    fallback: bool = True,
    combiners: Mapping[str, Combiner | Mixture] = MappingProxyType({}),
) -> list[League]:
    """A league per environment that the policies come from.

    Args:
        policies: by label.
        extent: how much to run.
        scenarios: to judge policies on; those that they were trained on by default.
        folder: of real tracks, or of a folder per set of them; None leaves them out.
        fallback: whether policies also run with their fallback.
        combiners: learned combiners of the bank, and mixtures, to run beside, by label.

    Raises:
        ValueError: a policy of an unknown environment, an unknown scenario, or one that a policy
            cannot serve.
    """
    for name in scenarios:
        one_of("scenario", name, known_scenarios())
    for label, policy in policies.items():
        one_of(f"environment of policy {label!r}:", policy.manifest.environment, environments())
    found = []
    for environment in environments():
        mine = {k: p for k, p in policies.items() if p.manifest.environment == environment}
        if not mine:
            continue
        each = {k: own_conditions(k, p, scenarios) for k, p in mine.items()}
        own = {c.name: c for conditions in each.values() for c in conditions}
        answers = {k: [c.name for c in conditions] for k, conditions in each.items()}
        tracks = _folder(folder, problem_in(environment).tracks)
        found.append(
            League(
                environment, mine, list(own.values()), extent, fallback, tracks, combiners, answers
            )
        )
    return found


def _folder(given: Path | None, tracks: Tracks | None) -> Path | None:
    """Where a problem's tracks lie: in the folder given, or in one of their name there."""
    return None if given is None or tracks is None else data_folder(tracks.name, given)


def own_conditions(label: str, policy: Policy, scenarios: Sequence[str] = ()) -> list[Condition]:
    """The conditions that a policy is judged in.

    Raises ValueError for a scenario that it cannot serve.
    """
    settings, environment = policy.manifest.settings, policy.manifest.environment
    given = settings["scenario"]
    trained = (given,) if isinstance(given, str) else tuple(given)
    problem = problem_in(environment)
    chosen = [s for s in scenarios if problem_of(s) is problem]
    if scenarios and not chosen:
        raise ValueError(
            f"policy {label!r} was trained in {environment} and cannot serve {scenarios[0]!r}: name "
            f"a scenario of the kind {problem.name}/..., such as {trained[0]!r}."
        )
    overrides = {} if scenarios else dict(settings.get("overrides") or {})
    found = []
    for name in chosen or trained:
        one_of(f"scenario of policy {label!r}:", name, known_scenarios())
        reason = problem.environment.refuses(find_scenario(name))
        if reason is not None:
            raise ValueError(f"a policy of {environment} cannot serve {name!r}: {reason}.")
        changes = ", ".join(f"{k}={v}" for k, v in overrides.items())
        title = f"{short(name)}, {changes}" if changes else short(name)
        found.append(Condition(title, name, overrides, OWN))
    return found


# ---- running


def evaluate(
    found: Sequence[League],
    processes: int = 1,
    progress: bool = True,
    told: Callable[[Bench], None] | None = None,
) -> list[Bench]:
    """Run every contest.

    Args:
        found: the leagues.
        processes: worker processes; 1 runs everything in this one.
        progress: whether to show a bar.
        told: called with each league's bench as soon as it is there.

    The answer does not depend on `processes`, times excepted.
    """
    positive_int("workers", processes)
    benches = []
    with workers(processes) as executor:
        for league in found:
            benches.append(_bench(league, executor, progress))
            if told is not None:
                told(benches[-1])
    return benches


def _bench(league: League, executor: Executor | None, progress: bool) -> Bench:
    conditions = league.conditions()
    tasks = [(i, *part) for i, c in enumerate(conditions) for part in parts(league, c)]
    done: dict[tuple[int, int], Part] = {}
    total = sum(count for _, _, count in tasks)
    what = f"recordings, {league.problem.title}"
    with tqdm(total=total, desc=what, disable=not progress, unit="") as bar:
        for (i, first, count), part in _played(league, conditions, tasks, executor):
            done[i, first] = part
            bar.set_postfix_str(conditions[i].name, refresh=False)
            bar.update(count)
    results = []
    for i, condition in enumerate(tqdm(conditions, desc="comparing", disable=not progress)):
        own = [done[key] for key in sorted(done) if key[0] == i]
        results.append(joined(league, condition, own))
    return Bench(league, tuple(results), tuple(_verdicts(league, results)))


Task = tuple[int, int, int]


def _played(
    league: League,
    conditions: Sequence[Condition],
    tasks: Sequence[Task],
    executor: Executor | None,
) -> Iterator[tuple[Task, Part]]:
    """Each task with its part, as they come."""
    if executor is None:
        for task in tasks:
            yield task, play(league, conditions[task[0]], *task[1:])
        return
    running = {executor.submit(play, league, conditions[t[0]], *t[1:]): t for t in tasks}
    for future in as_completed(running):
        yield running[future], future.result()


# ---- judging


def _verdicts(league: League, results: Sequence[Result]) -> Iterator[Verdict]:
    for result in results:
        if result.condition.kind != OWN:
            continue
        name = result.condition.name
        labels = [label for label in league.policies if name in league.answers[label]]
        against = {label: result.main.difference(label, BEST_FIXED) for label in labels}
        if not labels:
            continue
        p = np.array([d.p_value for d in against.values()])
        adjusted = holm(np.where(np.isfinite(p), p, 1.0))
        shifted = [r for r in results if r.condition.base == name]
        for label, p_holm in zip(labels, adjusted, strict=True):
            yield _verdict(league, result, shifted, label, against[label], float(p_holm))


def _verdict(
    league: League,
    result: Result,
    shifted: Sequence[Result],
    label: str,
    d: PairedDifference,
    p_holm: float,
) -> Verdict:
    main = result.main
    row, nan = main[label], math.nan
    gains = (nan,) * 4 if row.diverges else (d.relative_gain, d.gain_low, d.gain_high, row.score)
    prices = tuple(
        c.measure.label for c in list(result.comparisons.values())[1:] if _dearer(c, label)
    )
    beats = all(beaten(main, label, rival) for rival in rivals(league, main, label))
    losses = [r for r in shifted if beaten(r.main, BEST_FIXED, label)]
    kept = FALLBACK.format(label)
    rescued = [r for r in losses if kept in r.main and not beaten(r.main, BEST_FIXED, kept)]
    not_learnt = (HAND_RULE, *league.adapting)
    ahead = [n for n in not_learnt if n in main and beaten(main, n, label)]
    return Verdict(
        label, result.condition.name, *gains[:3], d.p_value, p_holm, gains[3], beats and p_holm < LEVEL and not prices, prices, tuple(ahead),
        tuple(r.condition.name for r in losses), tuple(r.condition.name for r in rescued),
    )  # fmt: skip


def rivals(league: League, found: Comparison, label: str) -> list[str]:
    """The fixed parameters that a policy must beat: the best ones here, and its own."""
    return [n for n in (BEST_FIXED, league.fixed_label(label)) if n in found]


def beaten(found: Comparison, label: str, other: str) -> bool:
    """Whether `label` is better than `other` beyond doubt: touching 0 is not enough.

    One that diverges beats nobody, and is beaten by whoever does not.
    """
    if found[label].diverges or found[other].diverges:
        return found[other].diverges and not found[label].diverges
    return found.difference(label, other).gain_low > 0.0


def _dearer(found: Comparison, label: str) -> bool:
    """Whether a quantity grew by more than its price, and not by chance."""
    d = found.difference(label, BEST_FIXED)
    return not math.isfinite(d.relative_gain) or (d.relative_gain < -PRICE and d.gain_high < 0.0)


def failures(benches: Sequence[Bench]) -> list[str]:
    """A sentence on each policy that is not better than the best fixed parameters."""
    return [_failure(v) for bench in benches for v in bench.verdicts if not v.better]


def _failure(v: Verdict) -> str:
    text = f"{v.policy} is not better than the best fixed parameters on {v.condition}"
    if not math.isfinite(v.gain):
        return f"{text}: it diverges."
    text += (
        f": {100 * v.gain:+.1f} % (95 % interval {100 * v.low:+.1f} to {100 * v.high:+.1f} %, "
        f"p {v.p_holm:.3f})"
    )
    return f"{text}, at the price of {', '.join(v.prices)}." if v.prices else f"{text}."
