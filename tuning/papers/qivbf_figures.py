"""QIVBF's tables and figures, each run on its own setting: printed and corrected beside Kalman filters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.auv.problem import PROBLEM
from navgym.core.checks import Array
from navgym.metrics import rms, steady_state
from navgym.statespace.models import LinearModel
from navgym.tuning.cases import Cases
from navgym.tuning.comparison import Comparison, Entry, compare
from navgym.tuning.papers import expected
from navgym.tuning.papers.amounts import ReproductionAmount
from navgym.tuning.papers.claims import FAILS, HOLDS, PARTLY, QIVBF, TAKEN, Finding, judge
from navgym.tuning.papers.contenders import UNTUNED
from navgym.tuning.papers.expected import Check
from navgym.tuning.papers.part import Part, as_dict, check_table, told
from navgym.tuning.report import tables
from navgym.tuning.report.page import Figure, Section, Table
from navgym.tuning.report.plots import BAD, BEST, FAINT, INK, MORE, OWN, PLAIN, drawing, plain_log

LOSS = 0.3  # of the samples, independently: the paper names no rate
RATES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9)
SWEEPS = (1, 3, 5, 10, 20)
GAPS = (1, 2, 3, 5)  # samples since the last received one
MAGNIFIED = {1: 19.0, 2: 109.0, 3: 361.0, 5: 1891.0}  # Σl² (docs/science/qivbf.md, Extrapolation)
SHOWN = 120  # samples of the run that is drawn

ZEROS, PREDICTS, PRINTED, CORRECTED, WITHOUT = (
    "KF, a lost sample is 0 (eq. 2)", "KF that predicts", "QIVBF as printed", "QIVBF corrected",
    "VB that predicts",
)  # fmt: skip
ENTRIES = (
    Entry(ZEROS, "kf_zero"),
    Entry(PREDICTS, "kf"),
    Entry(PRINTED, "qivbf_printed"),
    Entry(CORRECTED, "qivbf", UNTUNED | {"fill": "extrapolate"}),
    Entry(WITHOUT, "vbakf", UNTUNED),
)
COLORS = {ZEROS: BAD, PREDICTS: PLAIN, PRINTED: OWN, CORRECTED: BEST, WITHOUT: MORE[0]}


def figures(size: ReproductionAmount) -> Iterator[Part]:
    """Tables 1 and 2 and figures 1 to 4."""
    yield setting()
    yield fill()
    yield pseudocode(size)
    seen = Traces.of(size.cases("nominal", loss=LOSS))
    yield position(seen, 0, "x", "figure 2")
    yield position(seen, 2, "y", "figure 3")
    yield error(seen, size)


# ---- table 2: what is given


def setting() -> Part:
    """Table 2, and what the paper leaves open."""
    model, scenario = LinearModel(), PROBLEM.scenarios["nominal"]
    printed = {"P0": (1.0,) * 4, "Q": (1e-3, 5e-4, 1e-3, 5e-4), "R": (1.0,) * 4}
    checks = tuple(
        Check(
            f"{name}: largest difference from the print", 0.0,
            float(np.abs(getattr(model, name) - np.diag(values)).max()), 0.0, 1e-12,
        )
        for name, values in printed.items()
    )  # fmt: skip
    free = PROBLEM.find("qivbf_printed").space.defaults
    rows = [
        *([n, "diag(" + ", ".join(f"{v:g}" for v in values) + ")", "the same"] for n, values in printed.items()),
        ["state, measurement", "[Px, Vx, Py, Vy], all measured", "the same; F of constant velocity"],
        ["sampling time", "–", f"{scenario.dt:g} s"],
        ["samples", "–", f"{scenario.steps}"],
        ["share lost", "a, without a value", f"{100 * LOSS:.0f} %, independently; figure 4 tries others"],
        ["x0", "–", "[" + ", ".join(f"{v:g}" for v in model.x0) + "], the truth drawn from N(x0, P0)"],
        ["N_VB of the printed filter", "–", f"{free['vb_iterations']:g}; table 1 tries others"],
        ["its priors", "–", f"counts of {free['prior_count']:g} for P and {free['initial_count']:g} for R, means P⁻ and R"],
        ["the corrected filter", "–", ", ".join(f"{k} {v:g}" for k, v in UNTUNED.items())],
    ]  # fmt: skip
    finding = Finding(
        QIVBF["table 2"], TAKEN,
        "P0, Q and R are those of the print. What it leaves open is ours, and is named in the table.",
    )  # fmt: skip
    table = Table(["", "print", "here"], rows, text_columns=(0, 1, 2))
    section = Section("Table 2: what is given, and what we took", told([finding]), [table])
    return Part(section, checks, findings=(finding,))


# ---- figure 1: the fill


def basis(times: Array) -> Array:
    """(3, ...) Lagrange's basis polynomials of nodes at −2, −1 and 0."""
    found: Array = np.stack(
        [times * (times + 1) / 2, -times * (times + 2), (times + 1) * (times + 2) / 2]
    )
    return found


def fill() -> Part:
    """Figure 1: the basis, and what its weights do to noise."""
    weights = basis(np.array([float(g) for g in GAPS]))
    magnified = (weights**2).sum(axis=0)
    checks = tuple(
        Check(f"Σl² at {g} samples past the last", MAGNIFIED[g], float(v), 0.0, 1e-9)
        for g, v in zip(GAPS, magnified, strict=True)
    )
    first = ", ".join(f"{w:g}" for w in weights[:, 0])
    finding = Finding(
        QIVBF["figure 1"], judge(bool(np.allclose(weights.sum(axis=0), 1.0)), bool(magnified[0] < 1.0)),
        f"The three weights of the first lost sample are {first} and add up to 1: a parabola is continued exactly. "
        f"But the noise of the three values comes out with {magnified[0]:.0f} times its variance, with "
        f"{magnified[1]:.0f} times at the second lost sample and {magnified[-1]:,.0f} times at the {GAPS[-1]}th.",
    )  # fmt: skip
    section = Section(
        "Figure 1: how a lost measurement is filled", told([finding]), [_basis_figure()]
    )
    return Part(section, checks, findings=(finding,))


def _basis_figure() -> Figure:
    caption = (
        "Left: the basis polynomials over the three received samples (circles), and their weights one sample "
        "on, where the fill is taken (dots). Right: by how much the fill's variance exceeds that of a "
        "measurement, over the length of the gap."
    )
    with drawing(caption, 3.1, ncols=2, width_ratios=(1.5, 1)) as ((left, right), made):
        t = np.linspace(-2.2, 1.1, 200)
        for curve, at, color, name in zip(
            basis(t), basis(np.array(1.0)), (PLAIN, OWN, BEST), ("k−3", "k−2", "k−1"), strict=True
        ):
            left.plot(t, curve, color=color, lw=1.6, label=f"l of sample {name}")
            left.plot(1.0, at, "o", color=color, ms=6)
            left.annotate(f"{at:g}", (1.0, at), (8, 0), textcoords="offset points", va="center")
        left.plot([-2, -1, 0], [1, 1, 1], "o", mfc="none", mec=FAINT, ms=8)
        left.axvline(1.0, color=FAINT, lw=1.0, ls=(0, (4, 3)))
        left.set_xticks([-2, -1, 0, 1], ["k−3", "k−2", "k−1", "k, lost"])
        left.set_xlim(-2.2, 1.4)
        left.grid(axis="y")
        left.legend(loc="upper left", fontsize=9)
        gaps = np.arange(1.0, 11.0)
        right.plot(gaps, (basis(gaps) ** 2).sum(axis=0), "o-", color=PLAIN, ms=4)
        right.axhline(1.0, color=FAINT, lw=1.2, ls=(0, (4, 3)))
        right.text(10.0, 1.15, "a measurement", ha="right", va="bottom", color=INK, fontsize=9)
        right.set_yscale("log")
        right.set_xlabel("samples since the last received one")
        right.set_ylabel("Σl², variance of the fill over R")
        right.grid(axis="y")
    return made[0]


# ---- table 1: the algorithm as printed


def pseudocode(size: ReproductionAmount) -> Part:
    """Table 1 run as it stands, at several numbers of sweeps, with and without losses."""
    lost = {rate: _lost(size, rate) for rate in (0.0, LOSS)}
    rows = [
        [f"{100 * rate:.0f} %", *(tables.percent(share) for share in shares.values())]
        for rate, shares in lost.items()
    ]
    usual = int(PROBLEM.find("qivbf_printed").space.defaults["vb_iterations"])
    least = min(lost[0.0].values())
    half = 1.96 * float(np.sqrt(lost[0.0][usual] * (1.0 - lost[0.0][usual]) / size.runs))
    check = Check(
        "share of runs that the printed filter loses, nothing lost", expected.PRINTED_DIVERGES,
        lost[0.0][usual], half, 0.1,
    )  # fmt: skip
    finding = Finding(
        QIVBF["table 1"], HOLDS if least < 0.01 else PARTLY if least < 0.5 else FAILS,
        f"With no measurement lost it loses the track in {_span(lost[0.0])} of the runs, whatever N_VB; at "
        f"{100 * LOSS:.0f} % lost in {_span(lost[LOSS])}.",
    )  # fmt: skip
    caption = "Runs that diverge: flagged by the filter, failed, or ten times worse than the filter that knows the noise."
    table = Table(["lost", *(f"N_VB = {n}" for n in SWEEPS)], rows, caption)
    section = Section("Table 1: the algorithm as printed", told([finding]), [table, check_table([check])])  # fmt: skip
    found = {f"{rate:g} lost": {str(n): s for n, s in shares.items()} for rate, shares in lost.items()}  # fmt: skip
    return Part(section, (check,), found, (finding,), size.runs)


def _span(shares: Mapping[int, float]) -> str:
    """Least and largest of some shares."""
    low, high = min(shares.values()), max(shares.values())
    alike = tables.percent(low) == tables.percent(high)
    return tables.percent(low) if alike else f"{tables.percent(low)} to {tables.percent(high)}"


def _lost(size: ReproductionAmount, rate: float) -> dict[int, float]:
    """Share of runs that the printed filter loses, by its number of sweeps."""
    entries = [
        Entry("oracle", "oracle", bound=True),
        *(Entry(f"{n}", "qivbf_printed", {"vb_iterations": n}) for n in SWEEPS),
    ]
    found = compare(entries, size.cases("nominal", loss=rate), "oracle")
    return {n: found[f"{n}"].divergence_rate for n in SWEEPS}


# ---- figures 2 to 4


def _compared(cases: Cases) -> Comparison:
    """Every contender beside the filter that knows the noise, by which divergence is judged."""
    return compare([Entry("oracle", "oracle", bound=True), *ENTRIES], cases, PREDICTS)


@dataclass(frozen=True, eq=False)
class Traces:
    """What the contenders of figures 2 to 4 made of the same recordings.

    Args:
        cases: the recordings.
        errors: (N, T, 4) estimate less truth, by label; infinite after a failure.
        comparison: of position RMSE.
    """

    cases: Cases
    errors: Mapping[str, Array]
    comparison: Comparison

    @classmethod
    def of(cls, cases: Cases) -> Traces:
        """Run every contender."""
        truth = np.stack([r.truth for r in cases.recordings])
        errors = {}
        for entry in ENTRIES:
            states = PROBLEM.run(entry.filter, cases.batch, entry.parameters).states
            errors[entry.label] = np.where(np.isfinite(states), states - truth, np.inf)
        return cls(cases, errors, _compared(cases))

    def sizes(self, label: str, states: slice | list[int]) -> Array:
        """(N, T) length of the error in some states."""
        with np.errstate(over="ignore"):
            found: Array = np.sqrt((self.errors[label][:, :, states] ** 2).sum(axis=2))
        return found

    def closer(self, label: str, other: str, states: list[int]) -> Share:
        """In how many runs `label` is closer to the reference than `other`, by RMSE over the run."""
        with np.errstate(over="ignore"):
            a, b = ((self.sizes(x, states) ** 2).mean(axis=1) for x in (label, other))
        return Share(int((a < b).sum()), len(a))


@dataclass(frozen=True)
class Share:
    """`count` runs of `total`, with a 95 % interval that knows small numbers (Wilson)."""

    count: int
    total: int

    @property
    def low(self) -> float:
        """Lower end of the interval."""
        z, p, n = 1.96, self.count / self.total, self.total
        around = z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        return float((p + z * z / (2 * n) - around) / (1 + z * z / n))

    def __str__(self) -> str:
        return f"{100 * self.count / self.total:.0f} %"


def position(seen: Traces, state: int, axis: str, where: str) -> Part:
    """Figures 2 and 3: position along one axis."""
    finding = _closer(seen, [state], where, f"Along {axis}")
    title = f"{where[0].upper()}{where[1:]}: the position in {axis}"
    section = Section(title, told([finding]), [_position_figure(seen, state, axis)])
    each = np.sqrt((seen.sizes(PREDICTS, [state]) ** 2).mean(axis=1))
    half = float(1.96 * each.std(ddof=1) / np.sqrt(len(each)))
    # both axes have the same Q and R
    share = dict(zip(expected.COLUMNS, expected.LOSSES["nominal"], strict=True))["kf"] / np.sqrt(2)
    check = Check(
        f"RMSE in {axis} of the KF that predicts, {100 * LOSS:.0f} % lost", float(share),
        float(each.mean()), half, 2 * expected.RELATIVE * float(share),
    )  # fmt: skip
    found = {label: _mean_size(seen, label, [state]) for label in (ZEROS, PREDICTS, CORRECTED)}
    return Part(section, (check,), {"mean_size_of_error": found}, (finding,), len(seen.cases))


def error(seen: Traces, size: ReproductionAmount) -> Part:
    """Figure 4: RMSE over time, and over the rate of loss."""
    at = {rate: _compared(size.cases("nominal", loss=rate)) for rate in RATES}
    finding = _closer(seen, [0, 2], "figure 4", "By the RMSE over a run")
    kept = max(at.values(), key=lambda c: c[PREDICTS].divergence_rate)[PREDICTS].divergence_rate
    worst = at[RATES[-1]][PREDICTS]
    said = (
        f" The Kalman filter that predicts diverges in {tables.percent(kept)} of the runs at most, over all loss rates, "
        f"and has {worst.mean:.2f} m at {100 * RATES[-1]:.0f} % lost."
    )
    finding = Finding(finding.claim, finding.verdict, finding.found + said)
    check = _riccati(size)
    rows = [
        [e.label, *(tables.error(c[e.label]) + _how_many(c, e.label) for c in at.values())]
        for e in ENTRIES
    ]
    head = ["lost", *(f"{100 * rate:.0f} %" for rate in RATES)]
    caption = "Position RMSE in m over whole runs with its 95 % interval, or the share of runs that diverge."
    table = Table(head, rows, caption)
    items: list[Table | Figure] = [_rmse_figure(seen, at), table, check_table([check])]
    section = Section("Figure 4: RMSE when measurements are lost", told([finding]), items)
    found = as_dict({f"{rate:g} lost": c for rate, c in at.items()})
    return Part(section, (check,), found, (finding,), size.runs)


def _how_many(found: Comparison, label: str) -> str:
    row = found[label]
    return f" ({tables.percent(row.divergence_rate)})" if row.diverges else ""


def _riccati(size: ReproductionAmount) -> Check:
    """The Kalman filter without losses, once settled, against its own covariance."""
    cases = size.cases("nominal", loss=0.0)
    square = cases.trace("kf", None, "rmse")
    late = square[:, square.shape[1] // 2 :].mean(axis=1)
    found = float(np.sqrt(late.mean()))
    half = float(1.96 * late.std(ddof=1) / np.sqrt(len(late)) / (2 * found))
    limit = rms(steady_state(LinearModel()).filtered, (0, 2))
    return Check("KF without losses, second half, against the Riccati equation", limit, found, half, 0.002)  # fmt: skip


def _closer(seen: Traces, states: list[int], where: str, how: str) -> Finding:
    """Who is closer to the reference than which Kalman filter."""
    pairs = {(a, b): seen.closer(a, b, states) for a in (PRINTED, CORRECTED) for b in (ZEROS, PREDICTS)}  # fmt: skip
    verdict = judge(*(share.low > 0.5 for share in pairs.values()))
    lost = seen.comparison[PRINTED].divergence_rate
    found = (
        f"{how} the corrected QIVBF is closer to the reference than a Kalman filter that takes lost samples for zeros "
        f"in {pairs[CORRECTED, ZEROS]} of {len(seen.cases)} runs, and closer than one that predicts through them in "
        f"{pairs[CORRECTED, PREDICTS]}. As printed it is closer than the former in {pairs[PRINTED, ZEROS]}, than the "
        f"latter in {pairs[PRINTED, PREDICTS]}, and loses the track in {tables.percent(lost)}."
    )
    return Finding(QIVBF[where], verdict, found)


def _mean_size(seen: Traces, label: str, states: list[int]) -> float:
    return float(seen.sizes(label, states).mean())


def _position_figure(seen: Traces, state: int, axis: str) -> Figure:
    caption = (
        f"Above: position in {axis} of one run with {100 * LOSS:.0f} % of the samples lost (marks at the foot); what "
        "leaves the axis is cut. Below: size of the error, mean over all runs with its 95 % band; dashed, the median "
        "of a filter that loses runs, whose mean says nothing."
    )
    recording = seen.cases.recordings[0]
    time, truth = recording.time[:SHOWN], recording.truth[:SHOWN, state]
    with drawing(caption, 5.4, nrows=2) as ((above, below), made):
        above.plot(
            time, truth, color=FAINT, lw=4.5, alpha=0.6, label="reference", solid_capstyle="round"
        )
        for entry in ENTRIES[:-1]:
            line = truth + seen.errors[entry.label][0, :SHOWN, state]
            above.plot(
                time,
                np.where(np.isfinite(line), line, np.nan),
                color=COLORS[entry.label],
                lw=1.3,
                label=entry.label,
            )
        low, high = min(truth.min(), 0.0), max(truth.max(), 0.0)
        room = 0.25 * (high - low)
        above.set_ylim(low - room, high + room)
        lost = recording.lost[:SHOWN].all(axis=1)
        above.plot(time[lost], np.full(lost.sum(), low - 0.9 * room), "|", color=INK, ms=6)
        above.set_xlim(time[0], time[-1])
        above.set_ylabel(f"position in {axis}, m")
        above.set_xlabel("time, s")
        above.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5, fontsize=9)
        above.grid(axis="y")
        for entry in ENTRIES[:-1]:
            _over_time(below, recording.time, seen, entry.label, [state])
        below.set_xlim(recording.time[0], recording.time[-1])
        plain_log(below)
        below.set_ylabel(f"|error in {axis}|, m")
        below.set_xlabel("time, s")
        below.grid(axis="y")
    return made[0]  # fmt: skip


def _rmse_figure(seen: Traces, at: Mapping[float, Comparison]) -> Figure:
    caption = (
        f"Left: distance to the reference (eq. 43) with {100 * LOSS:.0f} % lost, mean over runs with its 95 % band; dashed, "
        "the median of a filter that loses runs. Right: RMSE over whole runs by the share of lost samples, "
        "median where runs are lost (dashed)."
    )
    time = seen.cases.recordings[0].time
    with drawing(caption, 3.9, ncols=2, width_ratios=(1.6, 1)) as ((left, right), made):
        for entry in ENTRIES:
            _over_time(left, time, seen, entry.label, [0, 2])
            rows = [c[entry.label] for c in at.values()]
            lost = any(r.diverges for r in rows)
            style: dict[str, Any] = {
                "color": COLORS[entry.label],
                "marker": "o",
                "ms": 4,
                "lw": 1.4,
            }
            if lost:
                right.plot([100 * r for r in at], [r.median for r in rows], ls=(0, (4, 2)), **style)
            else:
                half = [r.high - r.mean for r in rows]
                right.errorbar([100 * r for r in at], [r.mean for r in rows], yerr=half, **style)
        left.set_xlim(time[0], time[-1])
        for axes in (left, right):
            plain_log(axes)
            axes.grid(axis="y")
        left.set_ylabel("RMSE(k), m")
        left.set_xlabel("time, s")
        right.set_xlabel("samples lost, %")
        left.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=9)
    return made[0]  # fmt: skip


def _over_time(axes: Any, time: Array, seen: Traces, label: str, states: list[int]) -> None:
    """Mean size of the error at each time with its band, or the median of a filter that loses runs."""
    each, color = seen.sizes(label, states), COLORS[label]
    if seen.comparison[label].diverges:
        middle = np.median(each, axis=0)
        known: NDArray[np.bool_] = np.isfinite(middle)
        axes.plot(time[known], middle[known], color=color, lw=1.4, ls=(0, (4, 2)), label=label)
        return
    mean = each.mean(axis=0)
    half = 1.96 * each.std(axis=0, ddof=1) / np.sqrt(len(each))
    axes.fill_between(time, np.maximum(mean - half, mean / 100), mean + half, color=color, alpha=0.25, lw=0)  # fmt: skip
    axes.plot(time, mean, color=color, lw=1.4, label=label)
