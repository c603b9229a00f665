"""Agents on real logs: beside the parameters that they start from, and beside filters that need none."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from navgym.agents.combiner.combiner import Combiner, combines
from navgym.agents.evaluation.rollout import Learnt, replay_filter, roll_out
from navgym.agents.evaluation.streamed import stream
from navgym.agents.evaluation.verdicts import shipped
from navgym.agents.mixture.mixture import Mixture
from navgym.agents.policies.loading import Agent
from navgym.agents.policies.policy import Policy
from navgym.agents.training.logs import Logs
from navgym.agents.training.reference import checked
from navgym.core.checks import Array
from navgym.problem import Problem, Run, problem_of
from navgym.tuned import Tuned
from navgym.tuning.cases import Cases

RESAMPLES = 4000
FEWEST = 5  # logs for an interval over them
TUNED, FALLBACK = "{}, tuned", "{} + fallback"

Runner = Callable[[Cases], Run]


@dataclass(frozen=True, eq=False)
class Score:
    """How one contender did on some logs under one rate of losses.

    Args:
        label: whose.
        condition: the rate of losses in words.
        fixes: (L,) one-step error of the fixes on each log, m; infinite where it failed.
        truth: (L,) error against the truth; None where that is not known.
        base: label of the parameters that it is measured against; "" for none.
    """

    label: str
    condition: str
    fixes: Array
    truth: Array | None
    base: str = ""

    @property
    def counts(self) -> Array:
        """(L,) what counts: the error against the truth where it is known, else that of the fixes."""
        return self.fixes if self.truth is None else self.truth


@dataclass(frozen=True, eq=False)
class Contest:
    """Agents among everybody else on logs.

    Args:
        logs: names of the logs.
        scores: of every contender under every rate of losses.
        base: of each agent's label, that of its tuned parameters.
    """

    logs: tuple[str, ...]
    scores: tuple[Score, ...]
    base: Mapping[str, str]

    def find(self, label: str, condition: str) -> Score:
        """The score of one contender."""
        return next(s for s in self.scores if (s.label, s.condition) == (label, condition))

    @property
    def conditions(self) -> list[str]:
        """Rates of losses in words."""
        return list(dict.fromkeys(s.condition for s in self.scores))


def contest(
    agents: Mapping[str, Agent],
    logs: Logs,
    draws: int,
    combiners: Mapping[str, Combiner | Mixture],
    fallback: bool = True,
    tuned: Mapping[str, Tuned] | None = None,
) -> Contest:
    """Run everybody on the logs, noise and losses of drawing formats from the test seeds.

    Args:
        agents: policies and mixtures, by label.
        logs: to report on.
        draws: of noise and losses per log and rate, where the format draws them.
        combiners: learned combiners of the bank, by label.
        fallback: whether policies also run as they are deployed.
        tuned: further fixed parameters, by label.

    Raises:
        ValueError: logs of another problem than an agent's, without fixes, or of another model.
    """
    for label, agent in agents.items():
        _fits(label, agent, logs)
    found: list[Score] = []
    ladder, base = _ladder(agents, logs.problem, combiners, fallback, tuned or {})
    for condition, cases in logs.by_rate("test", draws).items():
        checked(cases, logs)
        for label, runner in ladder.items():
            own = base.get(label, base.get(label.removesuffix(FALLBACK.format("")), ""))
            found.append(_score(label, condition, cases, runner(cases), own))
    return Contest(tuple(logs.name(p) for p in logs.paths), tuple(found), base)


def _fits(label: str, agent: Agent, logs: Logs) -> None:
    """ValueError unless the agent is for logs of this problem."""
    own = "auv" if isinstance(agent, Mixture) else agent.manifest.environment
    if problem_of(own).name != logs.problem.name:
        raise ValueError(
            f"{label} is for the {problem_of(own).title}, and {logs.paths[0].name} is a log of the "
            f"{logs.problem.title}: name logs of the same problem."
        )


def _ladder(
    agents: Mapping[str, Agent],
    problem: Problem,
    combiners: Mapping[str, Combiner | Mixture],
    fallback: bool,
    tuned: Mapping[str, Tuned],
) -> tuple[dict[str, Runner], dict[str, str]]:
    """Everybody who runs, from the plain filter to the agents; and what each agent is measured against."""
    names = dict.fromkeys([*problem.plain[:1], problem.contest.default, *problem.study.beside])
    adapting = [r.filter for r in problem.contest.rivals if r.adapts]
    wanted = [n for n in names if n in (problem.plain[0], problem.contest.default) or n in adapting]
    found: dict[str, Runner] = {n: of_fixed(n, None) for n in wanted}
    if combines(problem):
        found |= {label: _combined(c) for label, c in combiners.items()}
    for label, each in tuned.items():
        found[label] = of_fixed(each.filter, dict(each.parameters))
    base = {}
    for label, agent in agents.items():
        filter_name, values = started(agent)
        base[label] = own = TUNED.format(label)
        found[own] = of_fixed(filter_name, values)
        if isinstance(agent, Mixture):
            found[label] = _mixed(agent)
            continue
        found[label] = of_policy(agent)
        if fallback:
            found[FALLBACK.format(label)] = _streamed(agent)
    return found, base


def started(agent: Agent) -> tuple[str, dict[str, Any]]:
    """The filter and the tuned parameters that an agent starts from."""
    if isinstance(agent, Mixture):
        return agent.reference.filter, dict(agent.reference.parameters)
    return agent.manifest.filter, dict(agent.manifest.reference)


def of_fixed(filter_name: str, values: Mapping[str, Any] | None) -> Runner:
    """A filter with fixed parameters."""
    return lambda cases: cases.problem.run(filter_name, cases.batch, values, everything=True)


def _combined(combiner: Combiner | Mixture) -> Runner:
    return lambda cases: combiner.run(cases.batch, everything=True, fallback=True)


def _mixed(mixture: Mixture) -> Runner:
    return lambda cases: mixture.run(cases.batch, everything=True)


def of_policy(policy: Any) -> Runner:
    """A policy without its fallback."""

    def run(cases: Cases) -> Run:
        chooser = Learnt(policy)
        found = roll_out(chooser, cases.recordings)
        return cases.problem.run(
            replay_filter(chooser), cases.batch, found.schedules, found.interval, everything=True
        )

    return run


def _streamed(policy: Any) -> Runner:
    """States alone: what is foretold is known of the filter that would answer, not of the answers."""

    def run(cases: Cases) -> Run:
        states, _ = stream(policy, cases.recordings, cases.batch.steps)
        none = np.empty((len(cases), 0))
        return Run(
            states, np.zeros(len(cases), dtype=np.bool_), none[..., None, None], none[..., None],
            none, none, none.astype(np.int64),
        )  # fmt: skip

    return run


def _score(label: str, condition: str, cases: Cases, run: Run, base: str) -> Score:
    """Means over the draws of each log."""
    names = [r.meta["log"] for r in cases.recordings]
    of_log = [np.array([n == name for n in names]) for name in dict.fromkeys(names)]
    truth = cases.true_errors(run) if cases.has_truth else None
    silent = run.innovations.shape[1] == 0
    fixes = np.full(len(cases), math.nan) if silent else cases.foretold_errors(run)
    by_log = [np.array([e[w].mean() for w in of_log]) for e in (fixes, truth) if e is not None]
    return Score(label, condition, by_log[0], by_log[1] if truth is not None else None, base)


# ---- what it comes to


@dataclass(frozen=True)
class Gain:
    """By how much one score is below another.

    Args:
        mean: 1 − mean error / that of the other.
        low: end of the 95 % interval, logs drawn anew; NaN for fewer than `FEWEST` logs.
        high: the other end.
        worst: the smallest gain on a log.
    """

    mean: float
    low: float
    high: float
    worst: float


def gain(errors: Array, base: Array, seed: int = 0) -> Gain:
    """The gain of errors (L,) over those of another on the same logs."""
    if not np.isfinite(base).all() or not np.isfinite(errors).all():
        worse = np.isfinite(base).all() and np.isinf(errors).any()
        return Gain(-math.inf if worse else math.nan, math.nan, math.nan, math.nan)
    each = 1.0 - errors / base
    low = high = math.nan
    if len(errors) >= FEWEST:
        rng = np.random.default_rng(np.random.SeedSequence([0x10, seed]))
        drawn = rng.integers(0, len(errors), (RESAMPLES, len(errors)))
        found = 1.0 - errors[drawn].mean(axis=1) / base[drawn].mean(axis=1)
        low, high = np.quantile(found, [0.025, 0.975])
    return Gain(
        float(1.0 - errors.mean() / base.mean()), float(low), float(high), float(each.min())
    )


def failures(found: Contest) -> list[str]:
    """A sentence on each agent that is not better than its tuned parameters, by what counts."""
    said = []
    for label, base in found.base.items():
        pairs = [(found.find(label, c), found.find(base, c), c) for c in found.conditions]
        bad = [(c, gain(a.counts, b.counts).mean) for a, b, c in pairs]
        bad = [(c, g) for c, g in bad if not g > 0.0]
        if bad:
            told = ", ".join(f"{c} {100 * g:+.1f} %" for c, g in bad)
            said.append(f"{label} is not better than its tuned parameters: {told}")
    return said


def table(found: Contest) -> str:
    """The ladder as text: errors, and the agents' gains over their tuned parameters."""
    known = found.scores[0].truth is not None
    head = ["", "fixes, m", *(["position, m"] if known else []), "gain", "worst log"]
    lines = []
    for condition in found.conditions:
        rows = [head]
        for score in (s for s in found.scores if s.condition == condition):
            cells = [score.label, _number(score.fixes)]
            cells += [] if score.truth is None else [_number(score.truth)]
            if score.base:
                g = gain(score.counts, found.find(score.base, condition).counts)
                cells += [_shown(g), f"{100 * g.worst:+.1f} %" if math.isfinite(g.worst) else ""]
            rows.append(cells + [""] * (len(head) - len(cells)))
        widths = [max(len(r[i]) for r in rows) for i in range(len(head))]
        lines += [f"\n{condition}, {len(found.logs)} logs"]
        lines += [
            "  ".join(c.ljust(w) for c, w in zip(r, widths, strict=True)).rstrip() for r in rows
        ]
    return "\n".join(lines)


def _number(errors: Array) -> str:
    mean = float(errors.mean())
    return f"{mean:.3f}" if math.isfinite(mean) else ("–" if math.isnan(mean) else "diverges")


def _shown(g: Gain) -> str:
    if not math.isfinite(g.mean):
        return "–" if math.isnan(g.mean) else "diverges"
    ends = f" ({100 * g.low:+.1f} to {100 * g.high:+.1f})" if math.isfinite(g.low) else ""
    return f"{100 * g.mean:+.1f} %{ends}"


def as_json(found: Contest) -> dict[str, Any]:
    """As JSON holds it; what is infinite or unknown is null."""

    def plain(errors: Array | None) -> list[float | None] | None:
        if errors is None:
            return None
        return [float(e) if math.isfinite(e) else None for e in errors]

    rows = [
        {
            "label": s.label, "condition": s.condition, "fixes": plain(s.fixes),
            "truth": plain(s.truth), "against": s.base or None,
        }
        for s in found.scores
    ]  # fmt: skip
    return {"logs": list(found.logs), "rows": rows}


def labelled(paths: Sequence[Path]) -> list[str]:
    """Distinct names of agents' files: of the file, or of its folder where it is just what it holds."""
    names = [_name(p) for p in paths]
    if len(set(names)) < len(names):
        names = [f"{p.resolve().parent.name}/{p.stem}" for p in paths]
    twice = [n for n in names if names.count(n) > 1]
    if twice:
        raise ValueError(f"agents must have distinct names, got {twice[0]!r} twice.")
    return names


def _name(path: Path) -> str:
    alone = path.stem in ("policy", "mixture")
    folder = path.resolve().parent.name
    return f"{folder}" if alone and folder else str(path.stem)


def shipped_for(problem: Problem) -> list[Path]:
    """Files of the policies that come with navgym for a problem; ValueError for none."""
    found = [p for p in shipped() if problem_of(Policy.load(p).manifest.environment) is problem]
    if not found:
        raise ValueError(f"navgym ships no policy of the {problem.title}: name one.")
    return found
