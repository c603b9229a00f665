"""The evaluation as a page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from navgym.agents.evaluation import plots as evaluation_plots
from navgym.agents.evaluation.contest import (
    BEST_FIXED,
    DEFAULT,
    FALLBACK,
    HAND_RULE,
    OTHER,
    RANDOM,
    REAL,
    TRUE_REGIME,
    Result,
)
from navgym.agents.evaluation.tables import (
    bound_of,
    consistency_table,
    error_table,
    gain_table,
    ladders,
    learners,
    regime_table,
    verdict_table,
)
from navgym.agents.evaluation.verdicts import COMBINED, Bench, Verdict, beaten
from navgym.problem import Problem
from navgym.simulation import find_scenario
from navgym.tuning.comparison import Comparison
from navgym.tuning.report import plots, words
from navgym.tuning.report.page import Figure, Page, Section, Table, Tile

SCORING = (
    "A policy is better if the 95 % interval of its paired gain over the best fixed parameters (BCa "
    "bootstrap over recordings) stays above 0, if the permutation test agrees after Holm's correction "
    "for the policies tried on the same recordings, and if no other quantity grows by more than 2 %. An "
    "interval that touches 0 counts as not better. Score: 0 = the plain filter, 1 = the bound: {ends}."
)
NOTE = (
    "Everybody on the same recordings. Gains are paired, intervals from BCa bootstrap, p from sign "
    "flips, without correction. A run counts as diverged if it was flagged, failed, or is ten times "
    "worse than that of {yardstick}."
)


def scoring(benches: Sequence[Bench]) -> str:
    """How verdicts come about."""
    problems = [b.league.problem for b in benches]
    ends = [f"{p.title} `{p.contest.plain}` and `{p.contest.top}`" for p in problems]
    return SCORING.format(ends="; ".join(ends))


def note(bench: Bench) -> str:
    """What a ladder's figures are."""
    return NOTE.format(yardstick=f"`{bench.league.problem.contest.yardstick}`")


def about(problem: Problem) -> dict[str, str]:
    """Everybody in a problem's ladders, and what they are."""
    contest = problem.contest
    plain, *rivals = contest.rivals
    on_tracks = "; on tracks: tuned on the other fold of the tracks" if problem.tracks else ""
    found = {
        plain.label: plain.about,
        RANDOM: "parameters drawn anew at each decision (only where a policy was trained)",
        DEFAULT: f"the adaptive filter (`{contest.default}`) as shipped, its parameters never changed",
        HAND_RULE: contest.rule,
        BEST_FIXED: "the best parameters for the scenario that never change" + on_tracks,
        "fixed, as for …": "where they are others: the fixed parameters that a policy starts from",
        FALLBACK.format(
            "…"
        ): "the policy as deployed, sample by sample: best fixed parameters where "
        "it would leave what it knows",
        TRUE_REGIME: "parameters by the true regime, which nobody knows: a bound",
    }
    found |= {r.label: r.about for r in rivals}
    return found | {s.label: s.about for s in contest.seers}


def who(benches: Sequence[Bench]) -> list[Table]:
    """A table of everybody, per problem; only those who ran somewhere."""
    found = []
    for bench in benches:
        ran = {label for r in bench.results for label in r.main.errors}
        known = about(bench.league.problem)
        if COMBINED in ran:
            known[COMBINED] = "a small recurrent network that weighs the bank's modes anew"
        rows = [list(row) for row in known.items() if row[0] in ran or "…" in row[0]]
        found.append(
            Table(
                ["contender", "what it is"], rows, bench.league.problem.title, text_columns=(0, 1)
            )
        )
    return found


def page(benches: Sequence[Bench], provenance: Mapping[str, Any]) -> Page:
    """The report."""
    sections = [
        Section("Verdict", [scoring(benches)], [verdict_table(b) for b in benches if b.verdicts])
    ]
    for bench in benches:
        for result in bench.own():
            sections += _own(bench, result)
        sections += _rest(bench)
    sections.append(Section("Who is who", [], list(who(benches))))
    lede = [_sentence(bench, v) for bench in benches for v in bench.verdicts]
    title = "Does the policy beat the simpler ways?"
    return Page(title, lede, sections, _tiles(benches), provenance)


def _sentence(bench: Bench, v: Verdict) -> str:
    """A verdict in words."""
    main = bench.find(v.condition).main
    how = "is better than" if v.better else "is **not** better than"
    text = (
        f"**`{v.policy}`** {how} the best fixed parameters on `{v.condition}` "
        f"({main.measure.label}). {words.versus(main, v.policy, BEST_FIXED)}"
    )
    if v.prices:
        text += f" It pays with {plainly(v.prices)}."
    if v.ahead:
        verb = "beats" if len(v.ahead) == 1 else "beat"
        text += f" {words.listed(v.ahead)} {verb} it there, and learnt nothing."
    if COMBINED in main and beaten(main, COMBINED, v.policy):
        text += f" So does `{COMBINED}`, which learnt something else."
    if v.losses:
        text += f" It is worse than the best fixed parameters under {plainly(v.losses)}"
        text += f"; with its fallback it is not under {plainly(v.rescued)}." if v.rescued else "."
    return text


def plainly(names: Sequence[str]) -> str:
    """Names as words: a, b and c."""
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]


def _tiles(benches: Sequence[Bench]) -> list[Tile]:
    found = []
    for bench in benches:
        for v in bench.verdicts[:3]:
            value = "diverges" if math.isnan(v.gain) else f"{100 * v.gain:+.1f} %"
            text = f"{v.policy} against best fixed, `{v.condition}`"
            found.append(Tile(value, text, "best" if v.better else "own"))
    return found


# ---- an own condition


def _own(bench: Bench, result: Result) -> list[Section]:
    name, main = result.condition.name, result.main
    title = f"{bench.league.problem.title}, {name}"
    runs = len(next(iter(main.errors.values())))
    caption = f"Mean over {runs} fresh recordings of {main.measure.axis}, with its 95 % interval. Dashed: the lowest bound. Hollow: needs the truth. Pale and cut: diverges."
    figure = plots.ladder(main, learners(bench), caption, ranked=False)
    items: list[Table | Figure] = [figure, *ladders(bench, result, note(bench))]
    found = [Section(f"{title}: the ladder", list(_ahead(bench, result)), items)]
    found.append(Section(f"{title}: parameters and errors in time", [], _in_time(bench, result)))
    looks: list[Table | Figure] = [regime_table(bench, result)] if result.labels else []
    looks += [consistency_table(bench, result)] if result.consistency else []
    found.append(Section(f"{title}: by regime, and consistency", [], looks))
    shifts = bench.shifts(name)
    if shifts:
        every = [result, *shifts]
        found.append(_several(bench, f"{title}: off the training distribution", every))
    return found


def _ahead(bench: Bench, result: Result) -> Iterator[str]:
    """Where something without learning wins, and how far the bounds are."""
    main = result.main
    filters = bench.league.adapting
    for label in bench.league.policies:
        if main[label].diverges:
            yield f"`{label}` diverges."
            continue
        beside = [HAND_RULE] if HAND_RULE in main else []
        bound = bound_of(main)
        beside += [bound.label] if bound is not None else []
        found = [words.versus(main, label, other) for other in beside]
        found += [words.without_learning(main, filters, label)] if filters else []
        yield " ".join(found)
    yield f"The smallest error that anyone can have here is that of **`{words.best(main).label}`**."


def _in_time(bench: Bench, result: Result) -> list[Table | Figure]:
    colors = _colors(bench, result.main)
    space = bench.league.problem.environment.settings.SPACE
    steered = {n for p in bench.league.policies.values() for n in p.manifest.action_parameters}
    names = [p.name for p in space if p.name in steered]
    caption = (
        "What was chosen on the first recording, over the true regime (tint), which only the bound "
        "sees."
    )
    shown = {k: c for k, c in colors.items() if k in result.chosen}
    items: list[Table | Figure] = [evaluation_plots.traces(result, names, shown, space, caption)]
    if result.labels:
        caption = (
            "RMSE over all recordings around the switches into each regime (their number in "
            "brackets), with 95 % bands."
        )
        squared = {k: result.main.squared[k] for k in colors}
        axis, before, after = result.main.measure.axis, *_window(result)
        items.append(
            plots.after_switch(result.labels, squared, colors, caption, before, after, axis)
        )
    return items


def _window(result: Result) -> tuple[int, int]:
    """Seconds before and after a switch that most regimes last."""
    lengths = np.concatenate(
        [np.diff(np.flatnonzero(np.diff(each.regime))) for each in result.labels]
    )
    usual = int(np.quantile(lengths, 0.1)) if len(lengths) else 0
    return (15, 50) if usual >= 50 else (max(usual // 3, 2), max(usual, 5))


# ---- other conditions


def _rest(bench: Bench) -> list[Section]:
    others = [r for r in bench.rest() if r.condition.kind != REAL]
    real = [r for r in bench.rest() if r.condition.kind == REAL]
    found = []
    if others:
        title = f"{bench.league.problem.title}: scenarios that no policy here was trained on"
        found.append(_several(bench, title, others))
    return [*found, _tracks(bench, real)] if real else found


def _several(bench: Bench, title: str, results: Sequence[Result]) -> Section:
    text = [_worse(bench, label, results) for label in bench.league.policies]
    if results[0].condition.kind == OTHER:
        text.append(
            f"`{BEST_FIXED}` was tuned for each of these scenarios, which the policies have never met; "
            "“fixed, as for …” is what their user would have without them."
        )
        summaries = [(r.condition, find_scenario(r.condition.scenario).summary) for r in results]
        text += [f"`{condition.name}`: {summary}." for condition, summary in summaries]
    return Section(title, text, [gain_table(bench, results), error_table(bench, results)])


def _worse(bench: Bench, label: str, results: Sequence[Result]) -> str:
    """Where a policy, and where its fallback, stays behind."""
    found = [_against_fixed(n, results) for n in (label, FALLBACK.format(label))]
    ahead = []
    for name in (HAND_RULE, *bench.league.adapting, COMBINED):
        times = sum(name in r.main and beaten(r.main, name, label) for r in results)
        ahead += [f"`{name}` in {times}"] if times else []
    found += [f"It is beaten by {plainly(ahead)}."] if ahead else []
    return " ".join(each for each in found if each)


def _against_fixed(name: str, results: Sequence[Result]) -> str:
    there = [r for r in results if name in r.main]
    if not there:
        return ""
    worse = [r.condition.name for r in there if beaten(r.main, BEST_FIXED, name)]
    better = sum(beaten(r.main, name, BEST_FIXED) for r in there)
    tail = f"worse in {len(worse)}: {plainly(worse)}." if worse else "worse in none."
    return f"`{name}` is better than the best fixed parameters in {better} of {len(there)} conditions, {tail}"


def _tracks(bench: Bench, results: Sequence[Result]) -> Section:
    hardest = results[-1]
    problem = bench.league.problem
    assert problem.tracks is not None
    text = [
        f"{problem.tracks.about} `{BEST_FIXED}` was tuned on the other fold of the tracks; no policy "
        "has seen any. Intervals are over runs; they speak of these tracks."
    ]
    rivals = [problem.contest.plain, BEST_FIXED, problem.contest.highlight]
    for label in bench.league.policies:
        each = [words.versus(hardest.main, label, n) for n in rivals if n in hardest.main]
        text.append(f"**{hardest.condition.name}**: {' '.join(each)}")
    return Section("Real tracks", text, [gain_table(bench, results), error_table(bench, results)])


def _colors(bench: Bench, main: Comparison) -> dict[str, str]:
    """Colours of the few contenders that are shown in time."""
    found = {BEST_FIXED: plots.PLAIN, HAND_RULE: plots.MORE[1]}
    tints = [plots.OWN, plots.MORE[3], plots.MORE[2]]
    found |= dict(zip(bench.league.policies, tints, strict=False))
    bound = bound_of(main)
    found |= {} if bound is None else {bound.label: plots.INK}
    found |= {bench.league.problem.contest.highlight: plots.BEST}
    return {k: c for k, c in found.items() if k in main and not main[k].diverges}
