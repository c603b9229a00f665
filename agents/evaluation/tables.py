"""The evaluation's numbers as tables, as text for a terminal, and as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from navgym.agents.evaluation.contest import (
    AS_TRAINED,
    BEST_FIXED,
    FALLBACK,
    HAND_RULE,
    OWN,
    RANDOM,
    TRUE_REGIME,
    Result,
)
from navgym.agents.evaluation.verdicts import Bench, Verdict
from navgym.core.checks import Array
from navgym.tuning.comparison import Comparison, Row
from navgym.tuning.report import tables, words
from navgym.tuning.report.page import Table


def learners(bench: Bench) -> list[str]:
    """Policies and their fallbacks: what is set off."""
    return [n for label in bench.league.policies for n in (label, FALLBACK.format(label))]


def bound_of(found: Comparison) -> Row | None:
    """The row that follows the true regime."""
    return next((row for row in found.rows if row.label == TRUE_REGIME), None)


def marks(bench: Bench, rows: Mapping[str, Any]) -> list[str]:
    """Which rows to set off."""
    own = learners(bench)
    return ["own" if label in own else "" for label in rows]


# ---- verdicts


def verdict_table(bench: Bench) -> Table:
    """One line per policy and condition that it was trained for."""
    others = bench.league.quantities[1:]
    first = next(bench.own())
    head = ["policy", "on", f"gain in {first.main.measure.label}", "p (Holm)", "score"]
    head += ["of the table's gain", *(f"in {first.comparisons[q].measure.label}" for q in others)]
    head += ["µs/step", "jitter", "fallback", "better?"]
    rows = [_verdict_row(bench, v, others) for v in bench.verdicts]
    caption = (
        f"{bench.league.environment}. Of the table's gain: against the parameters by true regime. "
        "µs/step: the filter, and the policy's time for one decision spread over its steps, on this "
        "machine with all else that ran on it. Jitter: mean |Δ ln parameter| from one decision to the "
        "next. Fallback: share of the time that it is in force where "
        "the policy runs with one."
    )
    kinds = ["best" if v.better else "diverged" for v in bench.verdicts]
    return Table(head, rows, caption, kinds, text_columns=(0, 1))


def _verdict_row(bench: Bench, v: Verdict, others: Sequence[str]) -> list[str]:
    result = bench.find(v.condition)
    main = result.main
    bound = bound_of(main)
    share = tables.NOTHING
    if bound is not None and bound.gain > 0.0 and v.gain > 0.0:
        share = tables.percent(v.gain / bound.gain)
    kept = fallback_share(bench, v)
    gains = [tables.gain(result.comparisons[q][v.policy]) for q in others]
    return [
        v.policy, v.condition, tables.gain(main[v.policy]), _p(v.p_holm), tables.number(v.score), share,
        *gains, f"{main.microseconds[v.policy]:.1f}", f"{result.jitter[v.policy]:.2f}",
        tables.NOTHING if kept is None else tables.percent(kept), "yes" if v.better else "NO",
    ]  # fmt: skip


def fallback_share(bench: Bench, v: Verdict) -> float | None:
    """Share of the time that a policy's fallback was in force where it was trained, if it ran."""
    there = [bench.find(v.condition), *bench.shifts(v.condition)]
    found = [r for r in there if r.condition.kind == OWN or r.condition.name == AS_TRAINED]
    shares = [r.fallbacks.get(FALLBACK.format(v.policy)) for r in found]
    return next((s for s in shares if s is not None), None)


def _p(value: float) -> str:
    return "≤ .001" if value <= 0.001 else f"{value:.3f}".lstrip("0")


# ---- an own condition


def ladders(bench: Bench, result: Result, note: str = "") -> list[Table]:
    """The ladder, and beside it the other quantities where there are any."""
    first, *others = result.comparisons.values()
    own = learners(bench)
    found = [tables.ladder(first, own, note, ranked=False)]
    kinds = tables.kinds(first.rows, own)
    if others:
        rows = [[_named(r), *(tables.error(c[r.label]) for c in others)] for r in first.rows]
        caption = "The other quantities on the same recordings."
        head = ["contender", *(c.measure.axis for c in others)]
        found.append(Table(head, rows, caption, kinds))
        rows = [[_named(r), *(_gain(c, r.label) for c in others)] for r in first.rows]
        head = ["gain over best fixed", *(c.measure.label for c in others)]
        found.append(Table(head, rows, "Paired, with 95 % intervals.", kinds))
    return found


def _named(row: Row) -> str:
    return f"{row.label} (bound)" if row.bound else row.label


def by_regime(result: Result) -> tuple[tuple[str, ...], dict[str, Array]]:
    """Names of the regimes, and per label the RMS error (regimes,) over all their samples."""
    names = tuple(result.labels[0].meta["regimes"])
    labels = np.stack([each.regime for each in result.labels])
    masks = [labels == g for g in range(len(names))]
    found = {}
    for label, square in result.main.squared.items():
        means = [square[mask].mean() if mask.any() else np.nan for mask in masks]
        found[label] = np.sqrt(np.array(means))
    return names, found


def regime_table(bench: Bench, result: Result) -> Table:
    """Errors by true regime."""
    names, errors = by_regime(result)
    rows = [[k, *map(tables.size, values.tolist())] for k, values in errors.items()]
    caption = f"{result.main.measure.axis}, over all samples of a true regime, switches included."
    return Table(["in regime", *names], rows, caption, marks(bench, errors))


def consistency_table(bench: Bench, result: Result) -> Table:
    """Whether covariances tell the truth."""
    rows = [
        [k, *(f"{v[name]:.2f}" for name in ("nis", "inside", "nees"))]
        for k, v in result.consistency.items()
    ]
    caption = (
        "Mean NIS and NEES per degree of freedom: 1 where the covariance tells the truth, more where "
        "the filter is overconfident. Inside: share of NIS in their 95 % band; .95 is right. On the "
        "first recordings only."
    )
    kinds = marks(bench, result.consistency)
    return Table(["contender", "NIS", "inside", "NEES"], rows, caption, kinds)


# ---- several conditions


def gain_table(bench: Bench, results: Sequence[Result]) -> Table:
    """Gain over the best fixed parameters, a row per condition."""
    fixed = dict.fromkeys(bench.league.fixed_label(k) for k in bench.league.policies)
    wanted = (HAND_RULE, *fixed, *learners(bench))
    shown = [k for k in wanted if any(k in r.main for r in results)]
    rows = [[r.condition.name, *(_gain(r.main, k) for k in shown)] for r in results]
    caption = f"Paired gains in {results[0].main.measure.label}, with 95 % intervals."
    return Table(["gain over best fixed", *shown], rows, caption)


def _gain(found: Comparison, label: str) -> str:
    if label not in found or label == BEST_FIXED:
        return tables.NOTHING
    return "diverges" if found[label].diverges else tables.gain(found[label])


def aside(bench: Bench) -> tuple[str, ...]:
    """What is left out of the wide tables (results.json has it): dice, and filters that are wrong on purpose."""
    contest = bench.league.problem.contest
    others = [r for r in contest.rivals if not (r.adapts or r.bound or r.real_only)]
    return (RANDOM, *(r.label for r in others if r.label != contest.plain))


def error_table(bench: Bench, results: Sequence[Result]) -> Table:
    """Errors, a row per condition, the best that anyone can have in bold."""
    columns = list(dict.fromkeys(row.label for r in results for row in r.main.rows))
    left_out = aside(bench)
    columns = [k for k in columns if k not in left_out]
    rows = [[r.condition.name, *(_error(r.main, k) for k in columns)] for r in results]
    caption = (
        f"{results[0].main.measure.axis}: mean over recordings; bold: the smallest of those that "
        "need no truth."
    )
    return Table(["condition", *columns], rows, caption)


def _error(found: Comparison, label: str) -> str:
    if label not in found:
        return tables.NOTHING
    text = "diverges" if found[label].diverges else tables.size(found[label].mean)
    return f"**{text}**" if label == words.best(found).label else text


# ---- terminal and JSON


def several(bench: Bench, results: Sequence[Result]) -> list[str]:
    """Gains with their intervals, and the whole ladder's errors, for a terminal."""
    if not results:
        return []
    return [t.as_text() for t in (gain_table(bench, results), error_table(bench, results))]


def as_text(benches: Sequence[Bench]) -> str:
    """The tables for a terminal."""
    found = []
    for bench in benches:
        title = bench.league.problem.title
        for result in bench.own():
            found.append(f"{title}, {result.condition.name}")
            found += [t.as_text() for t in ladders(bench, result)]
            others = bench.shifts(result.condition.name)
            found += several(bench, others)
        found += several(bench, bench.rest())
        found += [verdict_table(bench).as_text()] if bench.verdicts else []
    return "\n\n".join(found)


def as_json(benches: Sequence[Bench], provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Everything measured; only "microseconds per filter step" and the provenance's load depend on
    the machine.
    """
    found: dict[str, Any] = {"provenance": dict(provenance)}
    for bench in benches:
        found[bench.league.environment] = {
            "policies": {
                k: {"settings": dict(p.manifest.settings), "training": dict(p.manifest.training)}
                for k, p in bench.league.policies.items()
            },
            "verdicts": [{k: _number(v) for k, v in asdict(v).items()} for v in bench.verdicts],
            "conditions": {_key(r): _result(r) for r in bench.results},
            "microseconds per filter step": {
                _key(r): {k: round(v, 3) for k, v in r.main.microseconds.items()}
                for r in bench.results
            },
        }
    return found


def _key(result: Result) -> str:
    base = result.condition.base
    return f"{base}, {result.condition.name}" if base else result.condition.name


def _result(result: Result) -> dict[str, Any]:
    found: dict[str, Any] = {
        "kind": result.condition.kind,
        "comparisons": {k: c.as_dict() for k, c in result.comparisons.items()},
        "fallback in force": dict(result.fallbacks),
        "jitter": dict(result.jitter),
    }
    if result.labels:
        names, errors = by_regime(result)
        found["by regime"] = {
            k: dict(zip(names, map(_number, v.tolist()), strict=True)) for k, v in errors.items()
        }
    if result.consistency:
        found["consistency"] = {
            k: {n: _number(x) for n, x in v.items()} for k, v in result.consistency.items()
        }
    return found


def _number(value: Any) -> Any:
    """JSON has no infinity and no NaN."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
