"""From increments of two IMUs to the matching quantities of IDAM eq. 58-71.

The frames im and is are the IMUs' own axes, frozen at the start. One *tape* record per filter step
holds what a filter needs of it; none of it depends on a filter's parameters, so it is made once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from navgym.core.checks import Array
from navgym.core.compile import kernel, part
from navgym.deck.recording import DualIMURecording
from navgym.inertial.strapdown import advance, cross, end_rate, turn

_f8, _i8 = np.float64, np.int64
TAPE = np.dtype(
    [
        ("V_s", _f8, (3,)),  # ∫ C_s^is f_s, m/s, with the step's disturbance
        ("V_m", _f8, (3,)),  # ∫ C_m^im f_m plus the rigid lever arm's part, m/s
        ("w_s", _f8, (3,)),  # mean rate over the step in is, rad/s, with its disturbance
        ("w_m", _f8, (3,)),  # the same of the main IMU in im
        ("dV", _f8, (3,)),  # what the step added to V_s
        ("q_s", _f8, (4,)),  # C_s^is at the end of the step, as a quaternion, scalar first
        ("q_mid", _f8, (4,)),  # the same in its middle
        ("q_m", _f8, (4,)),  # C_m^im at the end of the step
        ("omega", _f8, (3,)),  # main IMU's rate in its own axes at the end of the step, rad/s
        ("gap", _i8),  # IMU samples of the step that were filled in
        ("model", _i8),  # which of the lane's models holds in the step
        ("theta", _f8, (3,)),  # truth, rad, NaN where it is not known
        ("theta_rate", _f8, (3,)),
        ("regime", _f8),
    ]
)  # 344 bytes: 6.9 kB per second at 20 Hz
# rows of what strapdown mechanisation carries from step to step
LEVER, ATTITUDE_M, ATTITUDE_S, VELOCITY_M, VELOCITY_S = range(5)
HISTORY = 2  # samples before a step that its mechanisation looks back on


def tapes_of(recordings: Sequence[DualIMURecording]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Tapes (N, K) of recordings and their lengths (N,); shorter ones are padded with zeros."""
    lengths = np.array([r.steps for r in recordings])
    tapes = np.zeros((len(recordings), int(lengths.max())), TAPE)
    for tape, r in zip(tapes, recordings, strict=True):
        write_tape(r, tape[: r.steps])
    return tapes, lengths


def write_tape(recording: DualIMURecording, tape: NDArray[Any]) -> None:
    """Fill `tape` (K,) from one recording."""
    (main_angle, main_velocity, sub_angle, sub_velocity), made_up = filled(recording)
    disturbance = recording.disturbance
    mechanize(
        main_angle, main_velocity, sub_angle, sub_velocity, made_up, recording.model.lever_arm, recording.interval,
        recording.model.samples_per_step,
        np.empty((0, 6)) if disturbance is None else disturbance, tape,
    )  # fmt: skip
    for name in ("theta", "theta_rate"):
        value = getattr(recording, name)
        tape[name] = np.nan if value is None else recording.at_steps(value)
    regime = recording.regime
    tape["regime"] = np.nan if regime is None else recording.at_steps(regime)


def coarse_alignment(recording: DualIMURecording) -> Rotation:
    """Attitude of the sub in the main IMU's axes that best maps rates and forces onto each other.

    Wahba's problem over one-second means of rates and of specific forces, each kind at unit weight in
    all, over the samples that both IMUs have. Good to some arcminutes where both IMUs move; the dynamic deformation is its noise.
    """
    block = max(1, round(1.0 / recording.interval))
    count = len(recording) // block
    pairs = []
    for kind in ("angle", "velocity"):
        sides = [getattr(recording, f"{imu}_{kind}")[: count * block] for imu in ("main", "sub")]
        good = np.isfinite(np.hstack(sides)).all(axis=1, keepdims=True)
        left, right = (np.where(good, x, 0.0).reshape(count, block, 3).sum(axis=1) for x in sides)
        size = np.linalg.norm(left) or 1.0
        pairs.append([left / size, right / size])
    main, sub = (np.concatenate([p[i] for p in pairs]) for i in range(2))
    return Rotation.align_vectors(main, sub)[0]


def filled(recording: DualIMURecording) -> tuple[list[Array], NDArray[np.bool_]]:
    """The four streams without NaN, and which samples (T,) were filled in.

    A missing sample of one IMU is taken from the other by the coarse alignment; where both are
    missing, the last one received is held.
    """
    names = ("main_angle", "main_velocity", "sub_angle", "sub_velocity")
    streams = [getattr(recording, name) for name in names]
    made_up = recording.gaps
    if not made_up.any():
        return streams, made_up
    turn = coarse_alignment(recording)
    whole = [s.copy() for s in streams]
    for i, s in enumerate(streams):
        missing = np.isnan(s).any(axis=1)
        other = streams[(i + 2) % 4]
        whole[i][missing] = (turn if i < 2 else turn.inv()).apply(other[missing])
        missing = np.isnan(whole[i]).any(axis=1)
        first = int(np.argmin(missing))  # before it, the first one received is held backwards
        last = np.maximum.accumulate(np.where(missing, first, np.arange(len(s))))
        whole[i] = np.nan_to_num(whole[i][last])
    return whole, made_up


@kernel
def begin_lever(main_angle, lever, h, start):
    """The rigid lever arm's velocity ω × r at the start, from the first three increments."""
    omega = np.empty(3)
    end_rate(main_angle[0], main_angle[1], main_angle[2], h, omega)
    cross(omega, lever, start)


@part
def mechanize_step(
    main_angle, main_velocity, sub_angle, sub_velocity, filled, first, per, lever, h, start,
    q_m, q_s, V_m, V_s, out,
):  # fmt: skip
    """Fill a tape's record with the step whose first sample is `first`; q and V move on.

    The rigid lever arm's velocity needs no derivative of a rate: ∫ C (ω×ω×r + ω̇×r) is
    C (ω × r) less its value at the start. The rate at the end of a sample is extrapolated
    through the last three increments.
    """
    w_m, w_s, before = np.zeros(3), np.zeros(3), np.empty(3)
    omega, swing, levered = np.empty(3), np.empty(3), np.empty(3)
    out.gap = 0
    out.model = 0
    for i in range(3):
        before[i] = V_s[i]
    for k in range(first, first + per):
        j = max(k - 1, 0)
        advance(q_m, main_angle[k], main_velocity[k], main_angle[j], main_velocity[j], V_m, w_m)
        advance(q_s, sub_angle[k], sub_velocity[k], sub_angle[j], sub_velocity[j], V_s, w_s)
        out.gap += filled[k]
        if k - first == (per - 1) // 2:
            for i in range(4):
                out.q_mid[i] = q_s[i]
    k = first + per - 1
    end_rate(main_angle[k], main_angle[max(k - 1, 0)], main_angle[max(k - 2, 0)], h, omega)
    cross(omega, lever, swing)
    turn(q_m, swing, levered)
    for i in range(3):
        out.V_m[i] = V_m[i] + levered[i] - start[i]
        out.V_s[i] = V_s[i]
        out.w_m[i] = w_m[i] / (per * h)
        out.w_s[i] = w_s[i] / (per * h)
        out.dV[i] = V_s[i] - before[i]
        out.omega[i] = omega[i]
    for i in range(4):
        out.q_m[i], out.q_s[i] = q_m[i], q_s[i]


@part
def disturb(out, disturbance):
    """Add the errors (6,) of a step's transmitted matching quantities to its tape."""
    for i in range(3):
        out.V_s[i] += disturbance[i]
        out.w_s[i] += disturbance[3 + i]


@part
def mechanize_next(samples, filled, lever, h, moving, disturbance, tape):
    """Fill a tape's record with the step of `samples` (4, HISTORY + per, 3), those before it included."""
    mechanize_step(
        samples[0], samples[1], samples[2], samples[3], filled, HISTORY,
        samples.shape[1] - HISTORY, lever, h, moving[LEVER], moving[ATTITUDE_M],
        moving[ATTITUDE_S], moving[VELOCITY_M], moving[VELOCITY_S], tape,
    )  # fmt: skip
    disturb(tape, disturbance)


@kernel
def mechanize_live(samples, filled, lever, h, moving, disturbance, tapes):
    """Fill a tape (1,) with the step under way; see `navgym.deck.kernels.live`."""
    mechanize_next(samples, filled, lever, h, moving, disturbance, tapes[0])


@kernel
def mechanize(
    main_angle, main_velocity, sub_angle, sub_velocity, filled, lever, h, per, disturbance, tape
):
    """Fill the matching quantities of a tape (K,) from increments (T, 3) of both IMUs, `per` of them a step."""
    q_m, q_s = np.array([1.0, 0.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])
    V_m, V_s, start = np.zeros(3), np.zeros(3), np.empty(3)
    begin_lever(main_angle, lever, h, start)
    for step in range(len(tape)):
        mechanize_step(
            main_angle, main_velocity, sub_angle, sub_velocity, filled, step * per, per, lever, h,
            start, q_m, q_s, V_m, V_s, tape[step],
        )  # fmt: skip
        if len(disturbance) > 0:
            disturb(tape[step], disturbance[step])
