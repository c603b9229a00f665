"""What the 24-state deck filter believes, packed for its kernel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.deck.alignment import LAYOUT, RATE, STATES, THETA
from navgym.deck.mechanization import filled
from navgym.deck.model import DeckModel, lever_matrix
from navgym.deck.recording import DualIMURecording
from navgym.inertial.flexure import FlexureModel

f8 = np.float64
MODEL = np.dtype(
    [
        ("dt", f8),
        ("interval", f8),
        ("transition", f8, (3, 2, 2)),
        ("noise", f8, (3, 2, 2)),
        ("gain", f8, (3, 2)),  # what a constant acceleration adds to (θ, θ̇) in a step
        ("density", f8, (3,)),
        ("lever", f8, (3, 3)),
        ("gyro", f8),  # variance that a step adds to φ
        ("accelerometer", f8),  # and to δV
        ("rate", f8),  # variance of a rate difference
        ("start", f8, (STATES,)),  # standard deviations at the start
        ("omega", f8, (3,)),  # the main IMU's rate at the start
    ]
)


def pack(
    recording: DualIMURecording, flexures: Sequence[FlexureModel] | None = None
) -> NDArray[Any]:
    """What a lane believes: MODEL records, one per flexure model (the recording's by default)."""
    first = filled(recording)[0][0][:3]
    return pack_model(recording.model, recording.interval, first, flexures)


def pack_model(
    model: DeckModel, interval: float, first: Array, flexures: Sequence[FlexureModel] | None = None
) -> NDArray[Any]:
    """MODEL records without a recording.

    Args:
        model: what is believed.
        interval: s between IMU samples.
        first: (3, 3) rad, the main IMU's first three angle increments.
        flexures: a record for each of these; the model's own by default.
    """
    chosen = [model.flexure] if flexures is None else list(flexures)
    packed = np.zeros(len(chosen), MODEL)
    dt = interval * model.samples_per_step
    packed["dt"], packed["interval"] = dt, interval
    packed["lever"] = lever_matrix(model.lever_arm)
    packed["gyro"] = model.gyro_noise**2 * dt
    packed["accelerometer"] = model.accelerometer_noise**2 * dt
    packed["rate"] = model.rate_noise**2
    packed["start"] = _start(model)
    packed["omega"] = (11.0 * first[0] - 7.0 * first[1] + 2.0 * first[2]) / (6.0 * interval)
    for record, flexure in zip(packed, chosen, strict=True):
        write_flexure(record, flexure)
    return packed


def write_flexure(record: Any, flexure: FlexureModel) -> None:
    """Put a flexure model into a MODEL record."""
    dt = float(record["dt"])
    record["transition"] = flexure.transition(dt)
    record["noise"] = flexure.process_noise(dt)
    record["gain"][:, 0] = (1.0 - record["transition"][:, 0, 0]) / flexure.stiffness
    record["gain"][:, 1] = record["transition"][:, 0, 1]
    record["density"] = flexure.noise_density
    record["start"][THETA] = flexure.sigma
    record["start"][RATE] = flexure.rate_sigma


def _start(model: DeckModel) -> Array:
    """Standard deviations at the start: docs/science/idam.md#start-and-noise.

    The flexure's own follow by `write_flexure`.
    """
    each = {
        "L": model.misalignment, "DV": 1e-6, "PHI": 1e-8, "EPS": model.gyro_bias,
        "NABLA": model.accelerometer_bias, "VR": 1e-6,
    }  # fmt: skip
    found = np.zeros(STATES)
    for name, deviation in each.items():
        found[list(LAYOUT.indices(name))] = deviation
    return found
