"""Section 6 of IDAM, the shipborne experiment: its log's layout is read; its figures rest on its data."""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import navgym
from navgym.core.checks import Array
from navgym.deck.problem import PROBLEM
from navgym.deck.recording import DualIMURecording
from navgym.inertial.flexure import ARCMIN
from navgym.inertial.imu import DEGREE_PER_HOUR, NO_ERRORS
from navgym.tuning.papers import expected_idam as expected
from navgym.tuning.papers.claims import IDAM, OPEN, TAKEN, Finding, judge
from navgym.tuning.papers.deck_performance import AXES
from navgym.tuning.papers.expected import Check
from navgym.tuning.papers.idam_figures import Trials
from navgym.tuning.papers.part import Part, check_table, told
from navgym.tuning.report.page import Section, Table

SECONDS = 60.0  # of the made-up log
# device, information, unit and rate as table 1 has them, and navgym's columns
LAYOUT = (
    ("main IMU", "gyroscope", "°/h", 100.0, "main_gyro"),
    ("main IMU", "accelerometer", "m/s²", 100.0, "main_acc"),
    ("sub-IMU", "gyroscope", "°/h", 100.0, "sub_gyro"),
    ("sub-IMU", "accelerometer", "m/s²", 100.0, "sub_acc"),
    ("PHINS-1", "gyroscope", "°/h", 100.0, "ref1_gyro"),
    ("PHINS-1", "accelerometer", "m/s²", 100.0, "ref1_acc"),
    ("PHINS-2", "gyroscope", "°/h", 100.0, "ref2_gyro"),
    ("PHINS-2", "accelerometer", "m/s²", 100.0, "ref2_acc"),
    ("GNSS", "latitude", "°", 1.0, "latitude"),
    ("GNSS", "longitude", "°", 1.0, "longitude"),
)
POSITION = (45.0, 126.0)  # latitude and longitude of section 5, degrees
# A reference from 60 s of both PHINS is good to 1′ about the horizontal axes and 2′ about the
# vertical (read_deck_csv); that it moves as the truth does is what an error's deviation shows
OFFSET, MOVING = (1.0, 1.0, 2.0), 0.2


def section_6(trials: Trials) -> Iterator[Part]:
    """The log's layout (tables 1 and 2), and what its figures say."""
    yield layout()
    yield at_sea(trials)


# ---- tables 1 and 2


def layout() -> Part:
    """Tables 1 and 2: a made-up log in that layout is written, read and compared with its truth."""
    truth = made_up()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ship.csv"
        write_log(path, truth)
        one, two = expected.INSTALLED
        back = navgym.read("deck_csv", path, model=truth.model, deviation1=one, deviation2=two)
        bare = navgym.read("deck_csv", path, model=truth.model)
    error, without = _error(back, truth), _error(bare, truth)
    mean, moving = error.mean(axis=0), error.std(axis=0)
    checks = [
        Check(f"mean error of the reference about {a}, ′", 0.0, float(m), 0.0, most)
        for a, m, most in zip(AXES, mean, OFFSET, strict=True)
    ]
    checks += [
        Check(f"its deviation about {a}, ′", 0.0, float(m), 0.0, MOVING)
        for a, m in zip(AXES, moving, strict=True)
    ]
    fix = [float(back.meta[name]) for name in ("latitude", "longitude")]
    checks.append(Check("GNSS, off by, degrees", 0.0, float(np.abs(np.subtract(fix, POSITION)).max()), 0.0, 1e-3))  # fmt: skip
    lost = float(np.linalg.norm(without.mean(axis=0)))
    findings = (
        Finding(
            IDAM["table 1"], judge(all(c.holds for c in checks)),
            f"A made-up log of {SECONDS:.0f} s in this layout is written and read (`navgym.read(\"deck_csv\", …)`). The attitude of "
            f"the sub in the main IMU's axes, from both PHINS, is off by {' / '.join(f'{abs(v):.2f}' for v in mean)}′ in the mean and "
            f"moves within {' / '.join(f'{v:.2f}' for v in moving)}′ of the truth.",
        ),
        Finding(
            IDAM["table 2"], TAKEN,
            "Its angles are `deviation1` and `deviation2` of the reader, C = R_z(heading) R_y(pitch) R_x(roll). Left out, the "
            f"reference is off by {lost:.0f}′.",
        ),
    )  # fmt: skip
    rows = [
        [device, what, unit, f"{rate:g} Hz", f"{name}_x, _y, _z" if "_" in name else name]
        for device, what, unit, rate, name in LAYOUT
    ]
    table = Table(
        ["device", "information", "unit", "rate", "columns of navgym"],
        rows,
        "Table 1, and where each line goes. `time` in s comes first; GNSS cells stay empty between fixes.",
        text_columns=(0, 1, 2, 3, 4),
    )
    section = Section("Tables 1 and 2: the log of a ship", told(findings), [table, check_table(checks)])  # fmt: skip
    return Part(section, tuple(checks), findings=findings)


def made_up() -> DualIMURecording:
    """The setting of section 5 by perfect IMUs: what the PHINS stand for."""
    scenario = PROBLEM.scenarios["paper"]
    perfect = scenario.override(duration=SECONDS, main=NO_ERRORS, sub=NO_ERRORS)
    found: DualIMURecording = PROBLEM.simulate(perfect, [navgym.seeds("test", 1).start])[0]
    return found


def write_log(path: Path, recording: DualIMURecording) -> None:
    """Write a recording in the layout of table 1, each PHINS turned against its IMU by table 2."""
    h = recording.interval
    readings = {
        "main_gyro": recording.main_angle / h, "main_acc": recording.main_velocity / h,
        "sub_gyro": recording.sub_angle / h, "sub_acc": recording.sub_velocity / h,
    }  # fmt: skip
    for unit, name, (pitch, roll, heading) in zip(
        ("ref1", "ref2"), ("main", "sub"), expected.INSTALLED, strict=True
    ):
        side = Rotation.from_euler("ZYX", [heading, pitch, roll], degrees=True)
        for sensor in ("gyro", "acc"):
            readings[f"{unit}_{sensor}"] = side.apply(readings[f"{name}_{sensor}"])
    columns: dict[str, list[str]] = {"time": [repr(float(t)) for t in recording.time]}
    every = round(LAYOUT[0][3] / LAYOUT[-1][3])
    for *_, unit, _rate, name in LAYOUT:
        if name in ("latitude", "longitude"):
            value = repr(POSITION[name == "longitude"])
            rows = range(len(recording.time))
            columns[name] = [value if k % every == 0 else "" for k in rows]
            continue
        scaled = readings[name] / (DEGREE_PER_HOUR if unit == "°/h" else 1.0)
        for i, axis in enumerate(AXES):
            columns[f"{name}_{axis}"] = [repr(float(v)) for v in scaled[:, i]]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))


def _error(read: DualIMURecording, truth: DualIMURecording) -> Array:
    """(T, 3) of the reference attitude, arcmin."""
    assert read.reference is not None
    assert truth.reference is not None
    there = Rotation.from_quat(np.array(truth.reference)).inv()
    found: Array = (Rotation.from_quat(np.array(read.reference)) * there).as_rotvec() / ARCMIN
    return found


# ---- figures 7 to 10


def at_sea(trials: Trials) -> Part:
    """Figures 7 to 10: the numbers as printed, and what a single passage can tell."""
    checks = [
        Check(
            f"figure 10: gain of {a} over {b} in {axis}, % of its own RMSE", percent,
            100.0 * (1.0 - expected.PAPER_SEA[a][i] / expected.PAPER_SEA[b][i]), 0.0, 0.006,
        )
        for (a, b), gains in expected.PAPER_SEA_GAINS.items()
        for i, (axis, percent) in enumerate(zip(("roll", "pitch", "heading"), gains, strict=True))
    ]  # fmt: skip
    spread, ahead = _spread(trials)
    gains = expected.PAPER_SEA_GAINS["idam", "woam"]
    found = (
        f"The printed gains follow from the printed RMSE{'' if all(c.holds for c in checks) else ' but for those marked'}. In "
        f"our runs of section 5 the gain of IDAM over WOAM in attitude varies by {' / '.join(f'{v:.0f}' for v in spread)} % (sd) from run "
        f"to run about x, y, z, and IDAM is ahead in {' / '.join(f'{v:.0f}' for v in ahead)} % of them: gains of "
        f"{' / '.join(f'{v:g}' for v in gains)} % in one passage are "
        + ("within what chance gives." if all(g < 2 * s for g, s in zip(gains, spread, strict=True)) else "above what chance gives about some axes.")
    )  # fmt: skip
    findings = (
        Finding(IDAM["figure 7"], OPEN, "Nothing to run."),
        Finding(IDAM["figure 8"], OPEN, "Nothing to run."),
        Finding(IDAM["figure 9"], OPEN, "One passage, drawn; its numbers are those of figure 10."),
        Finding(IDAM["figure 10"], OPEN, found),
    )
    rows = [
        [m, *(f"{v:.3f}" for v in expected.PAPER_SEA[m]), *(f"{trials[m].mean('attitude', a):.2f}" for a in range(3))]
        for m in ("svram", "woam", "idam")
    ]  # fmt: skip
    head = ["", "roll at sea, ′", "pitch", "heading", "x here, ′", "y", "z"]
    caption = (
        "RMSE of the attitude: the paper's at sea, ours in the simulation of section 5. They are not the same ship, sea, or "
        "reference, and not to be compared in size."
    )
    items = [Table(head, rows, caption), check_table(checks)]
    section = Section("Figures 7 to 10: at sea", told(findings), items)
    done = {"gain_of_idam_over_woam_sd": spread.tolist(), "share_ahead": ahead.tolist()}
    return Part(section, tuple(checks), done, findings, len(trials.cases))


def _spread(trials: Trials) -> tuple[Array, Array]:
    """(3,) deviation of the gain of IDAM over WOAM from run to run, and share of runs it leads, in per cent."""
    idam, woam = (trials[m].errors.axes["attitude"] for m in ("idam", "woam"))
    gain = 100.0 * (1.0 - idam / woam)
    spread: Array = gain.std(axis=0, ddof=1)
    ahead: Array = 100.0 * (gain > 0.0).mean(axis=0)
    return spread, ahead
