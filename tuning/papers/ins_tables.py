"""INS/DVL on simulated missions: the matched filter, noise that changes, a Doppler log that is silent."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from navgym.core.checks import Array
from navgym.ins.layout import PHI, V
from navgym.ins.problem import PROBLEM
from navgym.ins.scenarios import InsRegime
from navgym.ins.scoring import tilts
from navgym.metrics import PairedDifference, paired_difference
from navgym.metrics.consistency import nees
from navgym.tuning.cases import Cases
from navgym.tuning.comparison import Comparison, Entry, Row
from navgym.tuning.comparison import compare as compare_all
from navgym.tuning.papers import expected_ins as expected
from navgym.tuning.papers.amounts import InsReproductionAmount
from navgym.tuning.papers.claims import PARTLY, QIVBF, Finding, judge
from navgym.tuning.papers.expected import Check
from navgym.tuning.papers.part import MARKS, Part, as_dict, told
from navgym.tuning.report.page import Section, Table

compare = functools.partial(
    compare_all, covariances=False
)  # of the matched filter they are shown above
AT_ONCE = 4  # missions whose covariances are in memory together
HORIZONTAL = slice(0, 2)
KEY = "✓ within the two intervals, ↓ better than the prototype's, ✗ outside."


def shown(mean: float, half: float) -> str:
    """A mean with half its interval, in digits that suit its size."""
    digits = 2 if mean < 10.0 else 1 if mean < 100.0 else 0
    return f"{mean:,.{digits}f} ± {half:,.{digits}f}"


def gained(d: PairedDifference) -> str:
    """A paired gain in per cent with its interval."""
    return f"{100 * d.relative_gain:+.1f} % ({100 * d.gain_low:+.1f} to {100 * d.gain_high:+.1f})"


def _half(row: Row) -> float:
    return max(row.high - row.mean, row.mean - row.low)


def _check(name: str, label: str, row: Row, value: float) -> Check:
    slack = expected.SPREAD * value
    return Check(f"{name}: {label}, m", value, row.mean, _half(row), slack, smaller_is_fine=True)


# ---- the filter that is right


@dataclass(frozen=True, eq=False)
class Matched:
    """What the matched filter did on missions that its model describes.

    Args:
        errors: (N,) RMSE by quantity.
        nees: (N,) mean NEES per degree of freedom by block of states.
    """

    errors: Mapping[str, Array]
    nees: Mapping[str, Array]

    @classmethod
    def of(cls, cases: Cases) -> Matched:
        """Run it, a few missions at a time."""
        parts = [
            cls._some(cases.take(range(first, min(first + AT_ONCE, len(cases)))))
            for first in range(0, len(cases), AT_ONCE)
        ]
        errors, blocks = (
            {name: np.concatenate([p[i][name] for p in parts]) for name in parts[0][i]}
            for i in (0, 1)
        )
        return cls(errors, blocks)

    @staticmethod
    def _some(cases: Cases) -> tuple[dict[str, Array], dict[str, Array]]:
        batch = cases.batch
        run = PROBLEM.run("ins_kf", batch, {"imu_noise_scale": 1.0}, everything=True)
        errors = PROBLEM.scoring.errors(batch, run.states, ("position", "heading"), (0.0, 1.0))
        judged = PROBLEM.scoring.scored(batch, (0.0, 1.0))
        truth = batch.truth[..., :9].copy()
        own = run.states[..., :9].copy()
        own[..., PHI], truth[..., PHI] = tilts(own[..., PHI], truth[..., PHI]), 0.0
        blocks = {}
        for name, at in (("position", HORIZONTAL), ("velocity", V), ("attitude", PHI)):
            each = nees(own[..., at], run.covariances[..., at, at], truth[..., at])
            each = each / (at.stop - at.start)
            blocks[name] = np.nanmean(np.where(judged, each, np.nan), axis=1)
        return dict(errors), blocks


def matched(size: InsReproductionAmount) -> Part:
    """Every grade of IMU, with fixes and without."""
    rows, checks, found = [], [], {}
    for grade, values in expected.MATCHED.items():
        for fixes, value in zip(("2 m per 10 s", "none"), values, strict=True):
            silent = {"fix_period": 0.0} if fixes == "none" else {}
            one = Matched.of(size.cases("nominal", grade=grade, **silent))
            name = f"{grade}, fixes {fixes}"
            checks += list(_matched_checks(name, one, value))
            cells = [shown(*_mean(x)) for x in (one.errors["heading"], *one.nees.values())]
            rows.append([grade, fixes, f"{shown(*_mean(one.errors['position']))} ({value:g})", *cells])  # fmt: skip
            found[name] = {k: _mean(x) for k, x in one.errors.items()} | {f"NEES {k}": _mean(x) for k, x in one.nees.items()}  # fmt: skip
    finding = _model_holds(checks)
    text = [*told([finding]), f"{size.runs} fresh missions each, nothing out of the ordinary, `imu_noise_scale` 1: the filter's model is the world's."]  # fmt: skip
    section = Section("Equations 3-4: the matched filter", text, [_matched_table(rows)])
    return Part(section, tuple(checks), found, (finding,), size.told)


def _matched_checks(name: str, one: Matched, value: float) -> Iterator[Check]:
    slack = expected.SPREAD * value
    yield Check(f"{name}: position, m", value, *_mean(one.errors["position"]), slack, smaller_is_fine=True)  # fmt: skip
    for block, each in one.nees.items():
        yield Check(f"{name}: NEES of {block}", expected.NEES, *_mean(each), expected.NEES_SLACK)


def _matched_table(rows: list[list[str]]) -> Table:
    head = ["grade", "fixes", "position, m", "heading, °", "NEES: position", "velocity", "attitude"]
    caption = "Horizontal position after 60 s; NEES per degree of freedom, of the horizontal position, velocity and attitude; in brackets the prototype's."  # fmt: skip
    return Table(head, rows, caption, text_columns=(0, 1))


def _mean(each: Array) -> tuple[float, float]:
    """Mean and half its 95 % interval."""
    return float(each.mean()), float(1.96 * each.std(ddof=1) / np.sqrt(len(each)))


def _model_holds(checks: list[Check]) -> Finding:
    own = [c for c in checks if "NEES" in c.what]
    off = [c.what for c in own if not c.holds]
    said = f"Corrected, NEES per degree of freedom lies between {min(c.found for c in own):.2f} and {max(c.found for c in own):.2f}"  # fmt: skip
    return Finding(QIVBF["equations 3-4"], PARTLY, said + (f"; off: {', '.join(off)}." if off else ": the covariance is right."))  # fmt: skip


# ---- noise that changes

ORACLE = Entry("oracle", "oracle", bound=True)
R10 = {"dvl_noise_scale": 10.0, "fix_noise_scale": 10.0, "magnetic_noise_scale": 10.0}
# the paper's fill: a parabola through the sensor's last three velocities, Σl² times its own R
PARABOLA = {"fill": "extrapolate", "fill_variance": 1e-4, "fill_growth": 1e-9}
QUADRATIC = "VB, parabola"
FILTERS = (
    Entry("KF", "ins_kf"), Entry("KF, R×10", "ins_kf", R10), Entry("gate 16.3", "ins_kf", {"gate": 16.3}),
    Entry("Student", "ins_student"), Entry("MCC", "ins_mcc"), Entry("VB", "ins_vb"),
    Entry(QUADRATIC, "ins_vb", PARABOLA), Entry("bank", "ins_bank"), ORACLE,
)  # fmt: skip
SMALL_Q = {"imu_noise_scale": 1.0}
SHAKEN = (
    Entry("KF, q 1", "ins_kf", SMALL_Q), Entry("Student, q 1", "ins_student", SMALL_Q),
    Entry("VB, q 1", "ins_vb", SMALL_Q), Entry("bank, q 1", "ins_bank", SMALL_Q),
    Entry("bank, q 1, vibration meter", "ins_bank", SMALL_Q | {"vibration_meter": "on"}),
)  # fmt: skip
WORLDS: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "dvl-switch": ("dvl-switch", {}),
    "dvl-switch, tactical": ("dvl-switch", {"grade": "tactical"}),
    "usbl-switch": ("usbl-switch", {}),
    "anomaly": ("anomaly", {}),
    "survey": ("survey", {}),
    "survey, tactical": ("survey", {"grade": "tactical"}),
    "vibration": ("vibration", {}),
}


def noise(size: InsReproductionAmount) -> tuple[Part, Mapping[str, Comparison]]:
    """Every filter as shipped where the noise of sensors or IMU changes."""
    found = {}
    for name, (scenario, overrides) in WORLDS.items():
        entries = [*FILTERS, *(SHAKEN if name == "vibration" else ())]
        found[name] = compare(entries, size.cases(scenario, **overrides), "KF", progress=name)
    checks = [
        _check(name, label, found[name][label], value)
        for name, values in expected.NOISE.items()
        for label, value in values.items()
    ]
    checks += [_near(name, one) for name, one in found.items()]
    shaken = found["vibration"]
    rows = [[e.label, shown(shaken[e.label].mean, _half(shaken[e.label]))] for e in SHAKEN]
    items = [
        _by_world(found, checks),
        Table(["vibration, IMU believed as in its data sheet", "position, m"], rows, "`imu_noise_scale` 1 where ten is the default."),
    ]  # fmt: skip
    section = Section("Noise that changes", [_noise_text(found, size.runs)], items)
    return Part(section, tuple(checks), as_dict(found), runs=size.told), found


def _near(name: str, one: Comparison) -> Check:
    d = one.difference("bank", "oracle")
    half = 0.5 * (d.gain_high - d.gain_low)
    return Check(f"{name}: bank over oracle", expected.NEAR_ORACLE, 1.0 - d.relative_gain, half, 0.0, smaller_is_fine=True)  # fmt: skip


def _by_world(found: Mapping[str, Comparison], checks: list[Check]) -> Table:
    marks = {c.what: f" ({c.expected:g}) {MARKS[c.verdict]}" for c in checks}
    rows = []
    for entry in FILTERS:
        cells = [
            shown(one[entry.label].mean, _half(one[entry.label]))
            + marks.get(f"{name}: {entry.label}, m", "")
            for name, one in found.items()
        ]
        rows.append([entry.label + (" (bound)" if entry.bound else ""), *cells])
    for label, other in (("bank", "KF"), ("bank", "Student"), ("bank", "oracle"), (QUADRATIC, "VB")):  # fmt: skip
        rows.append([f"{label} against {other}", *(gained(one.difference(label, other)) for one in found.values())])  # fmt: skip
    caption = "Horizontal RMSE after 60 s, m, mean and 95 % interval; paired gains below. In brackets the prototype's. " + KEY  # fmt: skip
    return Table(["filter, as shipped", *found], rows, caption)


def _noise_text(found: Mapping[str, Comparison], runs: int) -> str:
    gaps = {n: -one.difference("bank", "oracle").relative_gain for n, one in found.items()}
    quiet = {n: g for n, g in gaps.items() if n != "vibration"}
    lost = [f"{e.label} ({n})" for n, one in found.items() for e in FILTERS if one[e.label].median > 100.0]  # fmt: skip
    return (
        f"{runs} fresh missions of each scenario, paired. Where sensors change, the bank is {100 * min(quiet.values()):.1f} to "
        f"{100 * max(quiet.values()):.1f} % above the filter that is told every R; under vibration {100 * gaps['vibration']:.1f} %. "
        + (f"Locked out in most missions: {', '.join(lost)}." if lost else "None is lost in most missions.")
    )  # fmt: skip


# ---- a Doppler log that is silent


def hold(variance: float, growth: float, **more: float) -> dict[str, Any]:
    """Parameters by which the last velocity stands in for a lost one."""
    return {"fill": "hold", "fill_variance": variance, "fill_growth": growth} | more


WATER = "water track"
FILLS = (
    Entry("nothing", "ins_kf"), Entry("parabola, Σl²R", "ins_kf", PARABOLA),
    Entry("hold, R", "ins_kf", hold(1e-4, 1e-9)), Entry("hold, .1 + .003/s", "ins_kf", hold(0.1, 0.003)),
    Entry("hold, .3 + .03/s", "ins_kf", hold(0.3, 0.03)), Entry("hold, 1 + .01/s", "ins_kf", hold(1.0, 0.01)),
    Entry("hold until 15°", "ins_kf", hold(0.1, 0.03, fill_turn_limit=15.0)),
    Entry("VB", "ins_vb"), Entry(QUADRATIC, "ins_vb", PARABOLA), Entry("bank", "ins_bank"),
)  # fmt: skip
HOLDS_TRIED = ("hold, R", "hold, .1 + .003/s", "hold, .3 + .03/s", "hold, 1 + .01/s")
SILENT: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "outages, steady": ("outage", {"speed_process": "steady"}),
    "outages, fitted": ("outage", {}),
    "outages, fitted, tactical": ("outage", {"grade": "tactical"}),
    "bursts, steady": ("burst", {"speed_process": "steady"}),
    "bursts, fitted": ("burst", {}),
}


def silence(size: InsReproductionAmount) -> tuple[Part, Mapping[str, Comparison]]:
    """What stands in for a lost Doppler log, for a vehicle that keeps its speed and one that does not."""
    found, water = {}, {}
    for name, (scenario, overrides) in SILENT.items():
        found[name] = compare(FILLS, size.cases(scenario, **overrides), "nothing", progress=name)
        aided = size.cases(scenario, **overrides, water_period=1.0)
        water[name] = compare([Entry(WATER, "ins_kf")], aided, WATER)
    checks = list(_silence_checks(found, water))
    section = Section("A lost Doppler log", _silence_text(found, size), [_silence_table(found, water)])  # fmt: skip
    done = as_dict(found) | {f"{name}, {WATER}": one.as_dict() for name, one in water.items()}
    return Part(section, tuple(checks), done, runs=size.told), found


def _silence_checks(
    found: Mapping[str, Comparison], water: Mapping[str, Comparison]
) -> Iterator[Check]:
    for name, values in expected.FILLS.items():
        for label, value in values.items():
            row = (water if label == WATER else found)[name][label]
            yield _check(name, label, row, value)


def _silence_table(found: Mapping[str, Comparison], water: Mapping[str, Comparison]) -> Table:
    rows = []
    for label in (*(e.label for e in FILLS), WATER):
        cells = []
        for name, one in found.items():
            source = (water if label == WATER else found)[name]
            d = paired_difference(source.errors[label], one.errors["nothing"])
            gain = "" if label == "nothing" else f"; {gained(d)}"
            cells.append(shown(source[label].mean, _half(source[label])) + gain)
        rows.append([label, *cells])
    caption = (
        "Horizontal RMSE, m, mean and 95 % interval; then the paired gain over nothing. Variances in m²/s² and their growth "
        "per second; the water track is a further sensor, on the same missions."
    )
    return Table(["what stands in", *found], rows, caption)


def _silence_text(found: Mapping[str, Comparison], size: InsReproductionAmount) -> list[str]:
    said = [f"{size.runs} fresh missions each, no fixes. Steady: the vehicle keeps its speed; fitted: it wanders as that of real tracks does."]  # fmt: skip
    for name, one in found.items():
        best = min(HOLDS_TRIED, key=lambda label: one[label].mean)
        said.append(
            f"{name[0].upper()}{name[1:]}: the best hold of four (in hindsight) is “{best}”, {gained(one.difference(best, 'nothing'))} "
            f"over nothing; holding until the gyros have turned 15° is {gained(one.difference('hold until 15°', best))} against it."
        )  # fmt: skip
    return said


# ---- the paper's claim on its own model

RATES = (0.0, 0.3, 0.5, 0.9)


ON_ITS_MODEL = (
    Entry("KF", "ins_kf"), Entry("KF, parabola", "ins_kf", PARABOLA), Entry("VB", "ins_vb"), Entry(QUADRATIC, "ins_vb", PARABOLA),
)  # fmt: skip


def claim(
    size: InsReproductionAmount, noisy: Mapping[str, Comparison], silent: Mapping[str, Comparison]
) -> Part:
    """QIVBF (R estimated, lost velocities extrapolated) against the Kalman filter that predicts."""
    found: dict[str, Comparison] = {}
    for rate in RATES:
        lossy = InsRegime("calm", dvl_loss=rate, fix_loss=rate)
        name = f"{100 * rate:.0f} % lost"
        cases = size.cases("nominal", regimes=(lossy,))
        found[name] = compare(ON_ITS_MODEL, cases, "KF", progress=name)
    usual = [e.label for e in ON_ITS_MODEL]
    kinds = ((found, usual), (silent, ["nothing", "parabola, Σl²R", *usual[2:]]), (noisy, ["KF", "", *usual[2:]]))  # fmt: skip
    rows = [_claim_row(n, one, labels) for many, labels in kinds for n, one in many.items()]
    against = {
        name: one.difference(QUADRATIC, labels[0])
        for many, labels in kinds for name, one in many.items() if name != "0 % lost"
    }  # fmt: skip
    finding = _judged(against)
    head = ["", "KF predicts", "KF, parabola", "VB predicts", "QIVBF: VB, parabola", "QIVBF over KF", "what the parabola adds"]  # fmt: skip
    caption = "Horizontal RMSE, m. First losses at random of log and fixes where the noise is as believed, then silence, then noise that changes."  # fmt: skip
    section = Section("Conclusion: QIVBF against the Kalman filter, on the paper's own model", told([finding]), [Table(head, rows, caption)])  # fmt: skip
    return Part(section, tuple(_claim_checks(against)), as_dict(found), (finding,), size.told)


def _claim_row(name: str, one: Comparison, labels: list[str]) -> list[str]:
    cells = [shown(one[x].mean, _half(one[x])) if x else "–" for x in labels]
    gains = [gained(one.difference(QUADRATIC, x)) for x in (labels[0], "VB")]
    return [name, *cells, *gains]


def _claim_checks(against: Mapping[str, PairedDifference]) -> Iterator[Check]:
    for name, d in against.items():
        gain, half = 100 * d.relative_gain, 50 * (d.gain_high - d.gain_low)
        yield Check(f"{name}: gain of QIVBF over KF, %, claimed to be well above", 0.0, gain, half, 0.0, larger_is_fine=True)  # fmt: skip


def _judged(against: Mapping[str, PairedDifference]) -> Finding:
    ahead = [n for n, d in against.items() if d.gain_low > 0.0]
    behind = [n for n, d in against.items() if d.gain_high < 0.0]
    even = [n for n in against if n not in ahead and n not in behind]
    parts = [
        f"{word}: {'; '.join(f'{n} {100 * against[n].relative_gain:+.0f} %' for n in names)}."
        for word, names in (("Ahead", ahead), ("Behind", behind), ("Not told apart", even)) if names
    ]  # fmt: skip
    verdict = judge(*(n in ahead for n in against))
    return Finding(QIVBF["conclusion"], verdict, " ".join(parts))
