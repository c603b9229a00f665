"""Real recordings of two IMUs: a pendulum with optical truth, and a rigid frame."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

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


def pendulum(folder: Path) -> Part:
    """RepoIMU: two IMUs on a pendulum, with optical truth: attitude, and the frequency of the swing."""
    rows, checks, found = [], [], {}
    for trial, published in expected.PENDULUM.items():
        recording = navgym.read("repoimu", folder, trial=trial)
        reference = recording.reference
        assert reference is not None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of a few samples that were filled in
            estimate, bank = (
                navgym.estimate(name, recording, {"velocity_noise": 3.0})
                for name in ("alignment", "deck_bank")
            )
        assert estimate.attitude_error is not None
        assert bank.attitude_error is not None
        first = len(estimate.time) // 10
        late = estimate.attitude_error[first:] / 60.0
        whole, moving = _length(late), _length(late - late.mean(axis=0))
        others = bank.attitude_error[first:] / 60.0
        true = Rotation.from_quat(recording.at_steps(reference)[first:])
        swing = _length(np.degrees((true * true.mean().inv()).as_rotvec()))
        increments = flexure_increments(recording, Rotation.from_quat(reference[0].copy()))
        model = identify("nls", increments, recording.step, step=0.25, longest_lag=10.0)
        frequency = float(np.sqrt(model.frequency_squared[int(np.argmax(model.sigma))]))
        checks.append(
            Check(f"{trial}, frequency, rad/s", published, frequency, 0.0, 0.01 * published)
        )
        rows.append(
            [
                trial,
                f"{swing:.2f}",
                f"{whole:.2f}",
                f"{moving:.2f}",
                f"{_length(others):.2f}",
                f"{_length(others - others.mean(axis=0)):.2f}",
                f"{frequency:.3f}",
                f"{published}",
            ]
        )
        found[trial] = {
            "swing": swing,
            "rmse": whole,
            "rmse_without_offset": moving,
            "deck_bank": _length(others),
            "frequency": frequency,
        }
    text = [
        "RepoIMU (Szczęsna et al. 2016): relative attitude of two consumer IMUs on a swinging pendulum against an "
        "optical reference. The lever arm is unknown, so the velocities are given little weight (r_V = 3 m/s); both swing "
        "by tens of degrees, which is not what the flexure's model is made for."
    ]
    head = [
        "trial", "relative motion", "RMSE", "without its mean", "deck_bank", "without its mean",
        "λ by gyros, rad/s", "optical",
    ]  # fmt: skip
    caption = "Degrees, after the first tenth. The mean is the mounting about the swing axis, which planar motion does not show."
    return Part(
        Section("Real data: a pendulum", text, [Table(head, rows, caption)]), tuple(checks), found
    )


def quadrotor(folder: Path) -> Part:
    """Multi-IMU: two IMUs fixed to one frame. A filter that expects flexure must invent none."""
    recording = navgym.read("multi_imu", folder)
    rows, checks, found = [], [], {}
    for degrees in (0.2, 1.0, 5.0):
        flexure = FlexureModel(2.0, 4.0, np.radians(degrees))
        expecting = with_flexure(recording, flexure)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of a heading that 20 s do not show
            estimate, bank = (
                navgym.estimate(name, expecting, {"velocity_noise": 3.0})
                for name in ("alignment", "deck_bank")
            )
        theta = np.degrees(np.sqrt((estimate.theta**2).mean(axis=0)))
        own = np.degrees(np.sqrt(estimate.covariances[-1].diagonal()[THETA]))
        other = np.degrees(np.sqrt((bank.theta**2).mean(axis=0)))
        shown = (theta, other, own)
        rows.append([f"{degrees:g}", *(" / ".join(f"{v:.2f}" for v in x) for x in shown)])
        checks += [
            Check(f"{degrees:g} degrees expected, RMS of θ_{a}", 0.0, float(v), 0.0, float(o))
            for a, v, o in zip(AXES, theta, own, strict=True)
        ]
        found[f"{degrees:g}"] = {"theta": theta.tolist(), "own": own.tolist()}
    apart = float(np.linalg.norm(recording.meta["misalignment"]))
    text = [
        f"Hurwitz and Klein (2023): the two IMUs are {apart:.2f} degrees apart and rigid. Nothing bends, so θ should stay inside what the filter says it does not know: {_inside(checks)}."
    ]
    head = [
        "σ that the filter expects, degrees",
        "RMS of θ, x / y / z",
        "the same by deck_bank",
        "the filter's own deviation",
    ]
    return Part(
        Section("Real data: a rigid quadrotor", text, [Table(head, rows)]), tuple(checks), found
    )


def _inside(checks: Sequence[Check]) -> str:
    held = sum(c.holds for c in checks)
    return "it does" if held == len(checks) else f"it does in {held} of {len(checks)} figures"


def _length(errors: Array) -> float:
    """Root of the mean squared length of (K, 3)."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))
