"""Section 5 of IDAM: its setting, figures 4 to 6 and its numbers, from one set of paired runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from navgym.core.checks import Array
from navgym.deck.batch import DeckBatch
from navgym.deck.errors import run_errors
from navgym.deck.problem import PROBLEM
from navgym.deck.scenarios import CALM, GUESS
from navgym.inertial.flexure import ARCMIN, FlexureModel
from navgym.metrics import PairedDifference
from navgym.problem import Filter
from navgym.tuning.cases import Cases
from navgym.tuning.papers import expected_idam as expected
from navgym.tuning.papers.amounts import DeckReproductionAmount
from navgym.tuning.papers.claims import IDAM, TAKEN, Finding, judge
from navgym.tuning.papers.deck_performance import (
    AXES,
    Performance,
    shown,
    summary,
    try_out,
    with_flexure,
)
from navgym.tuning.papers.expected import Check
from navgym.tuning.papers.part import Part, check_table, told
from navgym.tuning.report.page import Figure, Section, Table
from navgym.tuning.report.plots import BAD, BEST, FAINT, INK, OWN, PLAIN, drawing

METHODS = ("idam", "woam", "svram")  # each believes what it identifies, and nothing else
COLORS = {"idam": BEST, "woam": OWN, "svram": PLAIN}
WIDTHS = {"idam": 1.1, "woam": 2.0, "svram": 3.2}  # where lines coincide, each is seen
ENLARGED = 30.0  # s at the end, figure 5 (b)


@dataclass(frozen=True, eq=False)
class Trials:
    """Filters on the setting of section 5, all from the same guess of the flexure.

    Args:
        cases: the recordings.
        by_name: what each filter did.
    """

    cases: Cases
    by_name: Mapping[str, Performance]

    @classmethod
    def of(cls, size: DeckReproductionAmount) -> Trials:
        """Run them all."""
        cases = size.cases("paper", believed=GUESS, lever_error=0.03)
        known = Cases(PROBLEM, _believing(cases.batch, CALM.flexure), cases.about)
        trials = {
            "alignment, flexure known": try_out(known, "alignment"),
            "alignment, guess": try_out(cases, "alignment"),
            **{name: try_out(cases, _unshrunk(name)) for name in METHODS},
            "idam_printed": try_out(cases, "idam_printed"),
            "idam, shrunk": try_out(cases, "idam"),
        }
        return cls(cases, trials)

    def __getitem__(self, name: str) -> Performance:
        return self.by_name[name]

    def worse(self, name: str, quantity: str, axis: int | None = None) -> bool:
        """Whether a rival's error is above IDAM's beyond doubt."""
        return bool(self[name].against(self["idam"], quantity, axis).low > 0.0)

    def over_time(self, quantity: str) -> tuple[Array, dict[str, Array]]:
        """Times (K,), and a quantity's error (K, 3) of each method on the first recording."""
        found = {m: run_errors(self.cases.batch, 0, self[m].first)[quantity] for m in METHODS}
        return self.cases.recordings[0].step_time, found


def section_5(size: DeckReproductionAmount, trials: Trials) -> Iterator[Part]:
    """The setting, figures 4 to 6 and the numbers."""
    yield setting(size)
    yield deflection(trials)
    yield attitude(trials)
    yield numbers(trials)


def _unshrunk(name: str) -> Filter:
    """A filter of the catalogue that believes what it identifies, and nothing else."""
    chosen = PROBLEM.filters[name]
    return replace(chosen, option=replace(chosen.option, shrunk=False))


def _believing(batch: DeckBatch, flexure: FlexureModel) -> DeckBatch:
    """The same mechanised recordings for a filter that believes another flexure."""
    given = [with_flexure(r, flexure) for r in batch.recordings]
    return replace(batch, recordings=tuple(given))


# ---- the setting


def setting(size: DeckReproductionAmount) -> Part:
    """Every number of section 5 beside ours, and what it leaves open."""
    s = PROBLEM.scenarios["paper"]
    free, as_printed = (PROBLEM.find(n).space.defaults for n in ("idam", "idam_printed"))
    printed = {
        "latitude, degrees": ((45.0,), (s.latitude,)),
        "speed, kn": ((20.0,), (s.speed * 3600.0 / 1852.0,)),
        "mean heading, degrees": ((45.0,), (s.heading,)),
        "sway, degrees": ((10.0, 10.0, 10.0), s.sway),
        "its rates, rad/s": ((np.pi / 4, np.pi / 4, np.pi / 5), s.sway_rate),
        "gyro bias of the sub IMU, °/h": ((0.01,), (s.sub.gyro_bias,)),
        "angle random walk, °/√h": ((0.001,), (s.sub.gyro_noise,)),
        "accelerometer bias, µg": ((50.0,), (s.sub.accelerometer_bias,)),
        "its noise (µg/√h in print), µg/√Hz": ((10.0,), (s.sub.accelerometer_noise,)),
        "installation, arcsec": ((5.0,), (s.sub.installation,)),
        "scale factor, ppm": ((5.0,), (s.sub.scale_factor,)),
        "IMU rate, Hz": ((100.0,), (s.rate,)),
        "static deformation, ′": ((10.0, 10.0, 30.0), s.static),
        "σ of the flexure, ′": ((6.0, 6.0, 10.0), CALM.sigma),
        "τ of the flexure, s": ((10.0, 10.0, 30.0), CALM.tau),
        "lever arm, m": ((10.0, 10.0, 2.0), s.lever_arm),
    }
    off = {n: float(np.abs(np.subtract(a, b)).max()) for n, (a, b) in printed.items()}
    check = Check("largest difference from the printed setting", 0.0, max(off.values()), 0.0, 1e-9)
    rows = [[n, _listed(a), _listed(b)] for n, (a, b) in printed.items()]
    seconds = s.duration if size.duration is None else size.duration
    ours = {
        "duration": f"{seconds:g} s, scored from 60 s on",
        "main IMU": f"errors {s.main.gyro_bias / s.sub.gyro_bias:g} times those of the sub IMU",
        "filter steps": f"{s.rate / s.samples_per_step:g} per second",
        "first belief of the flexure": f"a guess: σ {_listed(GUESS.sigma)}′, τ {_listed(GUESS.tau)} s",
        "lever arm as believed": "wrong by 3 cm (one sigma)",
        "kernel width": f"{free['kernel_width']:g}",
        "weight of model prediction": f"{_weight(free)}; as printed, {_weight(as_printed)}",
        "noise of the velocity channels": f"{free['velocity_noise']:g} m/s",
        "window of identification": f"{free['identification_window']:g} s",
    }
    rows += [[name, "–", value] for name, value in ours.items()]
    finding = Finding(
        IDAM["section 5 (setting)"], TAKEN,
        "Every printed number is taken, the sub IMU for the one it describes. What it leaves open is ours, below the "
        "printed lines of the table.",
    )  # fmt: skip
    table = Table(["", "print", "here"], rows, text_columns=(0, 1, 2))
    section = Section("Section 5: the setting", told([finding]), [table])
    return Part(section, (check,), findings=(finding,))


def _weight(parameters: Mapping[str, Any]) -> str:
    weight = parameters["model_error_weight"]
    return "off" if weight >= 1e6 else f"{weight:g} dt/q"


def _listed(values: object) -> str:
    return " / ".join(f"{v:.4g}" for v in np.atleast_1d(np.asarray(values, dtype=np.float64)))


# ---- figure 4


def deflection(trials: Trials) -> Part:
    """Figure 4: the deflection angle over time."""
    quantity = "theta"
    ahead = [trials.worse(m, quantity, a) for m in METHODS[1:] for a in range(3)]
    finding = Finding(IDAM["figure 4"], judge(*ahead), _order(trials, quantity, "θ"))
    bound = idam_bound()
    checks = [
        Check(f"split bound of θ_z at {t} s against its formula", e, b, 0.0, 1e-6)
        for t, e, b in zip((60, 300), _closed_form(), bound, strict=True)
    ]
    section = Section("Figure 4: the deflection angle", told([finding]), [_deflection_figure(trials)])  # fmt: skip
    done = {m: summary(trials[m]) for m in METHODS}
    return Part(section, tuple(checks), done, (finding,), len(trials.cases))


def _closed_form() -> tuple[float, float]:
    """σ/√(1 + βt/4) of the paper's z axis at 60 and 300 s, arcmin, β = 2.146/τ."""
    sigma, beta = CALM.sigma[2], 2.146 / CALM.tau[2]
    first, last = (float(sigma / np.sqrt(1.0 + beta * t / 4.0)) for t in (60.0, 300.0))
    return first, last


def _signed(value: float) -> str:
    return f"{round(value, 2) + 0.0:+.2f}"  # never -0.00


def _between(difference: PairedDifference) -> str:
    return f"{_signed(difference.low)} to {_signed(difference.high)}"


def _order(trials: Trials, quantity: str, sign: str) -> str:
    """Paired differences of the rivals from IDAM, about each axis."""
    said = []
    for name in METHODS[1:]:
        cells = []
        for i, axis in enumerate(AXES):
            d = trials[name].against(trials["idam"], quantity, i)
            cells.append(f"{_signed(d.mean_difference)}′ about {axis} ({_between(d)})")
        said.append(f"`{name}` less `idam`: " + ", ".join(cells))
    return f"RMSE of {sign}, {len(trials.cases)} paired runs. " + "; ".join(said) + "."


def _line(axes: Any, time: Array, values: Array, name: str) -> None:
    axes.plot(time, values, color=COLORS[name], lw=WIDTHS[name], label=name.upper())


def _deflection_figure(trials: Trials) -> Figure:
    caption = (
        "θ of one run (the paper, too, draws one) and what each method makes of it. A constant offset is the part of θ that "
        "only the flexure's model can tell from the static deformation; the fast part all of them follow."
    )
    time, errors = trials.over_time("theta")
    true = trials.cases.batch.tapes["theta"][0, : len(time)] / ARCMIN
    with drawing(caption, 6.0, nrows=3, sharex=True) as (panels, made):
        for i, (axes, axis) in enumerate(zip(panels, AXES, strict=True)):
            axes.plot(time, true[:, i], color=FAINT, lw=4.0, alpha=0.6, label="true θ")
            for name, error in reversed(errors.items()):
                _line(axes, time, true[:, i] + error[:, i], name)
            axes.set_ylabel(f"θ about {axis}, ′")
            axes.grid(axis="y")
        panels[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, fontsize=9)
        panels[-1].set_xlim(time[0], time[-1])
        panels[-1].set_xlabel("time, s")
    return made[0]


# ---- figure 5


def attitude(trials: Trials) -> Part:
    """Figure 5: the attitude error over time, whole and enlarged."""
    ahead = [trials.worse(m, "attitude") for m in METHODS[1:]]
    lengths = ", ".join(f"`{m}` {shown(trials[m], 'attitude')}′" for m in METHODS)
    known, guess = trials["alignment, flexure known"], trials["alignment, guess"]
    shrunk = trials["idam, shrunk"]
    found = (
        f"Length of the attitude error: {lengths}. Without identifying anything it is {guess.mean('attitude'):.2f}′ with a guess "
        f"of the flexure and {known.mean('attitude'):.2f}′ with the true one, and {shrunk.mean('attitude'):.2f}′ where `idam` "
        "shrinks what it identifies toward the guess, as it does by default."
    )
    finding = Finding(IDAM["figure 5"], judge(*ahead), found)
    small = known.mean("attitude") / known.mean("theta")
    check = Check(
        "attitude error over that of θ, flexure known",
        float(np.linalg.norm(expected.ORACLE_ATTITUDE) / np.linalg.norm(expected.ORACLE_THETA)),
        small, 0.0, 0.1, smaller_is_fine=True,
    )  # fmt: skip
    items: list[Table | Figure] = [_attitude_figure(trials), check_table([check])]
    section = Section("Figure 5: the attitude error", told([finding]), items)
    return Part(section, (check,), {}, (finding,), len(trials.cases))


def _attitude_figure(trials: Trials) -> Figure:
    caption = f"Error of the deck's total attitude in one run: (a) from 10 s on, (b) the last {ENLARGED:.0f} s enlarged."
    time, errors = trials.over_time("attitude")
    spans = (time >= 10.0, time >= time[-1] - ENLARGED)
    grid = {"nrows": 3, "ncols": 2, "width_ratios": (1.7, 1), "sharex": "col"}
    with drawing(caption, 5.6, **grid) as (panels, made):
        for i, axis in enumerate(AXES):
            for axes, span in zip(panels[i], spans, strict=True):
                for name, error in reversed(errors.items()):
                    _line(axes, time[span], error[span, i], name)
                axes.axhline(0.0, color=INK, lw=0.6)
                axes.set_xlim(time[span][0], time[span][-1])
                axes.grid(axis="y")
            panels[i][0].set_ylabel(f"error about {axis}, ′")
        panels[0][0].set_title("(a)")
        panels[0][1].set_title("(b)")
        place = {"loc": "lower left", "bbox_to_anchor": (0.08, 1.0), "borderaxespad": 0.1}
        panels[0][0].legend(ncols=3, fontsize=9, **place)
        for axes in panels[-1]:
            axes.set_xlabel("time, s")
    return made[0]


# ---- figure 6 and the numbers


def numbers(trials: Trials) -> Part:
    """Figure 6 and the RMSE that section 5 prints."""
    by_name, idam = trials.by_name, trials["idam"]
    ahead = [trials.worse(m, "attitude", a) for m in METHODS[1:] for a in range(3)]
    findings = (
        Finding(IDAM["figure 6"], judge(*ahead), _order(trials, "attitude", "the attitude")),
        _numbers(trials),
    )
    z = idam.mean("theta", 2)
    checks = [Check("θ_z of idam against the paper's 4.260′", 4.260, z, idam.half("theta", 2), 1.0)]
    for name, percent in expected.PAPER_GAINS.items():
        what = f"the paper's gain over {name}, % of its own RMSE"
        checks.append(Check(what, percent, _printed_gain(name), 0.0, 0.006))
    rows = [_row(name, t, idam) for name, t in by_name.items()]
    head = [
        "filter", "z of θ", "sd", "z of attitude", "θ̇", "diverged", "θ_z less IDAM's", "p", "paper",
    ]  # fmt: skip
    caption = (
        f"RMSE from 60 s on, mean over {len(trials.cases)} paired test seeds with its 95 % interval, arcmin "
        "(θ̇: arcmin/s). sd: deviation of the z figure from seed to seed. The paper has one run and does "
        "not say which attitude its figure is; only θ is of its size."
    )
    items: list[Table | Figure] = [_axes_figure(trials), _runs_figure(trials), Table(head, rows, caption), check_table(checks)]  # fmt: skip
    section = Section("Figure 6 and the numbers of section 5", told(findings), items)
    done = {name: summary(t) for name, t in by_name.items()}
    return Part(section, tuple(checks), done, findings, len(trials.cases))


def _printed_gain(method: str) -> float:
    return 100.0 * (1.0 - expected.PAPER_Z["idam"] / expected.PAPER_Z[method])


def _numbers(trials: Trials) -> Finding:
    """What holds of 4.260, 5.032 and 6.560′, and of their order."""
    idam, (early, late) = trials["idam"], idam_bound()
    z, half = idam.mean("theta", 2), idam.half("theta", 2)
    sd = float(idam.each("theta", 2).std(ddof=1))
    said = [
        f"`idam` has {z:.2f} ± {half:.2f}′ with a deviation of {sd:.2f}′ from seed to seed; σ/√(1 + βt/4) is {early:.2f}′ at "
        f"60 s and {late:.2f}′ at 300 s, whatever the filter."
    ]
    right = [abs(z - expected.PAPER_Z["idam"]) <= half + 1.0]
    for name in METHODS[1:]:
        right.append(trials.worse(name, "theta", 2))
        said.append(_against(trials, name))
    return Finding(IDAM["section 5 (numbers)"], judge(*right), " ".join(said))


def _against(trials: Trials, name: str) -> str:
    """A rival beside IDAM about z, and how many runs a gap of the paper's size takes to be seen."""
    d = trials[name].against(trials["idam"], "theta", 2)
    gap = expected.PAPER_Z[name] - expected.PAPER_Z["idam"]
    each = trials[name].each("theta", 2) - trials["idam"].each("theta", 2)
    spread = float(each.std(ddof=1))
    if d.low > 0.0:
        word = f"is worse by {d.mean_difference:.2f}′ ({d.low:.2f} to {d.high:.2f})"
    elif d.high < 0.0:
        word = f"is **better** by {-d.mean_difference:.2f}′ ({-d.high:.2f} to {-d.low:.2f})"
    else:
        word = f"cannot be told from it ({_between(d)}′)"
    needed = max(2, int(np.ceil((2.8 * spread / gap) ** 2)))
    return (
        f"`{name}` {word}; the paper has it {gap:.2f}′ worse. Their difference varies by {spread:.2f}′ (sd) from seed to "
        f"seed, so a gap of the paper's size takes {needed} paired runs to be seen with 80 % power."
    )


def _row(name: str, trial: Performance, idam: Performance) -> list[str]:
    sd = trial.each("theta", 2).std(ddof=1)
    cells = [name, shown(trial, "theta", 2), f"{sd:.2f}", shown(trial, "attitude", 2)]
    cells += [shown(trial, "theta_rate"), f"{100 * trial.diverged.mean():.0f} %"]
    if trial is idam:
        cells += ["–", "–"]
    else:
        d = trial.against(idam, "theta", 2)
        cells += [f"{_signed(d.mean_difference)} ({_between(d)})", f"{d.p_value:.2g}"]
    paper = expected.PAPER_Z.get(name)
    return [*cells, "–" if paper is None else f"{paper:.3f}"]


def idam_bound() -> tuple[float, float]:
    """Split bound of the paper's z axis at 60 and 300 s, arcmin."""
    values = CALM.flexure.split_deviation(np.array([60.0, 300.0]))[:, 2] / ARCMIN
    return float(values[0]), float(values[1])


def _axes_figure(trials: Trials) -> Figure:
    caption = (
        "RMSE by axis, mean over runs with its 95 % interval; crosses: the paper's single run. Its crosses stand beside θ, "
        "whose size they have."
    )
    with drawing(caption, 3.3, ncols=2) as (panels, made):
        for axes, (quantity, title) in zip(
            panels, (("theta", "deflection θ"), ("attitude", "total attitude")), strict=True
        ):
            for j, name in enumerate(METHODS):
                x = np.arange(3) + 0.27 * (j - 1)
                mean = [trials[name].mean(quantity, a) for a in range(3)]
                half = [trials[name].half(quantity, a) for a in range(3)]
                axes.bar(
                    x, mean, 0.24, yerr=half, color=COLORS[name], ecolor=INK, label=name.upper()
                )
                if quantity == "theta":
                    axes.plot(x[2], expected.PAPER_Z[name], "x", color=BAD, ms=8, mew=2)
            axes.set_xticks(range(3), AXES)
            axes.set_title(title)
            axes.set_ylim(0.0, None)
            axes.grid(axis="y")
            axes.set_axisbelow(True)
        panels[0].set_ylabel("RMSE, ′")
        panels[1].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, fontsize=9)
    return made[0]


def _runs_figure(trials: Trials) -> Figure:
    """Every run's z figure beside its mean, the bound and the paper's value."""
    caption = "RMSE of θ_z of each run (dots), mean with 95 % interval, the paper's single run (cross); the dashed line is the split bound at 300 s."
    with drawing(caption, 0.7 + 0.42 * len(trials.by_name)) as (axes, made):
        rng = np.random.default_rng(0)
        for i, (name, trial) in enumerate(trials.by_name.items()):
            each = trial.each("theta", 2)
            axes.plot(each, i + 0.25 * rng.uniform(-1, 1, len(each)), ".", ms=3, color=FAINT)
            axes.errorbar(
                trial.mean("theta", 2),
                i,
                xerr=trial.half("theta", 2),
                fmt="o",
                ms=5,
                color=BEST if name == "idam" else PLAIN,
            )
            if name in expected.PAPER_Z:
                axes.plot(expected.PAPER_Z[name], i, "x", color=BAD, ms=7, mew=2)
        axes.axvline(idam_bound()[1], color=FAINT, ls=(0, (4, 3)), lw=1.0)
        axes.set_yticks(range(len(trials.by_name)), list(trials.by_name))
        axes.invert_yaxis()
        axes.set_xlabel("RMSE of θ about z, ′")
        axes.set_xlim(0.0, None)
        axes.grid(axis="x")
    return made[0]
