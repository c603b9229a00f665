"""Real recordings of two IMUs: a pendulum with optical truth, and a rigid frame."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import navgym
from navgym.core.checks import Array
from navgym.deck.alignment import THETA
from navgym.deck.estimation import flexure_increments
from navgym.identification import identify
from navgym.inertial.flexure import FlexureModel
from navgym.tuning.papers import expected_idam as expected
from navgym.tuning.papers.deck_performance import AXES, with_flexure
from navgym.tuning.papers.expected import Check
from navgym.tuning.papers.part import Part
from navgym.tuning.report.page import Section, Table

FILTERS = ("alignment", "alignment_mcc", "alignment_own", "deck_bank", "deck_bank_lever")
DISTRUST = {"velocity_noise": 3.0}  # m/s: nobody knows the lever arm, or the clocks to a sample


def pendulum(folder: Path) -> Part:
    """RepoIMU: two IMUs on a pendulum, with optical truth: attitude, and the frequency of the swing."""
    rows, checks, found = [], [], {}
    for trial, published in expected.PENDULUM.items():
        recording = navgym.read("repoimu", folder, trial=trial)
        frequency, swing = _frequency(recording), _swing(recording)
        each = {name: _attitude_errors(name, recording) for name in FILTERS}
        checks.append(
            Check(f"{trial}, frequency, rad/s", published, frequency, 0.0, 0.01 * published)
        )
        for name, (whole, moving) in each.items():
            told = [trial, f"{swing:.2f}", f"{frequency:.3f}", f"{published}"]
            first = told if name == FILTERS[0] else [""] * len(told)
            rows.append([*first, name, f"{whole:.2f}", f"{moving:.2f}"])
        found[trial] = {"swing": swing, "frequency": frequency, "rmse": each}
    text = [
        "RepoIMU (Szczęsna et al. 2016): relative attitude of two consumer IMUs on a swinging pendulum against an "
        "optical reference. The lever arm is unknown, so the velocities are given little weight (r_V = 3 m/s); both swing "
        "by tens of degrees, which is not what the flexure's model is made for."
    ]
    head = [
        "trial", "relative motion", "λ by gyros, rad/s", "optical", "filter", "RMSE", "without its mean",
    ]  # fmt: skip
    caption = "Degrees, after the first tenth. The mean is the mounting about the swing axis, which planar motion does not show."
    table = Table(head, rows, caption, text_columns=(4,))
    return Part(Section("Real data: a pendulum", text, [table]), tuple(checks), found)


def _quietly(name: str, recording: Any) -> Any:
    """An estimate, without warnings of a few samples that were filled in and of a heading that 20 s hide."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return navgym.estimate(name, recording, DISTRUST)


def _attitude_errors(name: str, recording: Any) -> tuple[float, float]:
    """RMSE of the relative attitude after the first tenth, degrees: whole, and without its mean."""
    errors = _quietly(name, recording).attitude_error
    late = errors[len(errors) // 10 :] / 60.0
    return _length(late), _length(late - late.mean(axis=0))


def _swing(recording: Any) -> float:
    """RMS of the true relative motion after the first tenth, degrees."""
    true = recording.at_steps(recording.reference)
    turned = Rotation.from_quat(true[len(true) // 10 :])
    return _length(np.degrees((turned * turned.mean().inv()).as_rotvec()))


def _frequency(recording: Any) -> float:
    """Angular frequency of the swing by the gyros, rad/s."""
    first = Rotation.from_quat(recording.reference[0].copy())
    increments = flexure_increments(recording, first)
    model = identify("nls", increments, recording.step, step=0.25, longest_lag=10.0)
    return float(np.sqrt(model.frequency_squared[int(np.argmax(model.sigma))]))


def quadrotor(folder: Path) -> Part:
    """Multi-IMU: two IMUs fixed to one frame. A filter that expects flexure must invent none."""
    recording = navgym.read("multi_imu", folder)
    rows, checks, found = [], [], {}
    for degrees in (0.2, 1.0, 5.0):
        expecting = with_flexure(recording, FlexureModel(2.0, 4.0, np.radians(degrees)))
        for name in FILTERS:
            theta, own = _invented(name, expecting)
            shown = (" / ".join(f"{v:.2f}" for v in x) for x in (theta, own))
            rows.append([f"{degrees:g}" if name == FILTERS[0] else "", name, *shown])
            checks += [
                Check(f"{name}, {degrees:g} degrees expected, RMS of θ_{a}", 0.0, v, 0.0, o)
                for a, v, o in zip(AXES, theta, own, strict=True)
            ]
            found[f"{degrees:g}, {name}"] = {"theta": theta, "own": own}
    apart = float(np.linalg.norm(recording.meta["misalignment"]))
    text = [
        f"Hurwitz and Klein (2023): the two IMUs are {apart:.2f} degrees apart and rigid. Nothing bends, so θ should stay inside what the filter says it does not know: {_inside(checks)}."
    ]
    head = ["σ that the filter expects", "filter", "RMS of θ, x / y / z", "its own deviation"]
    table = Table(head, rows, "Degrees.", text_columns=(1,))
    return Part(Section("Real data: a rigid quadrotor", text, [table]), tuple(checks), found)


def _invented(name: str, recording: Any) -> tuple[list[float], list[float]]:
    """RMS of θ on each axis, and what the filter says at the end that it does not know of it, degrees."""
    estimate = _quietly(name, recording)
    theta = np.degrees(np.sqrt((estimate.theta**2).mean(axis=0)))
    own = np.degrees(np.sqrt(estimate.covariances[-1].diagonal()[THETA]))
    return theta.tolist(), own.tolist()


def _inside(checks: Sequence[Check]) -> str:
    held = sum(c.holds for c in checks)
    return "it does" if held == len(checks) else f"it does in {held} of {len(checks)} figures"


def _length(errors: Array) -> float:
    """Root of the mean squared length of (K, 3)."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))
