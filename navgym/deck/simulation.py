"""Deck recordings: ship motion, flexure, and what two IMUs make of them.

Each recording draws from generators of its own for flexure, each IMU, slams, glitches, outliers and
regimes, so that a change of one leaves the others' numbers as they were. numpy draws, recursions
are compiled.

The main IMU's increments are integrals of analytic rates and specific forces (Simpson's rule). The
sub IMU's follow from C_s^m = Exp(θ) Exp(Φ) and f_s = f_m + u̇ + ω × u with u = ω × r + ṙ: the
integral of u̇ is a difference, so the white acceleration of the flexure is integrated exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from navgym.core.checks import Array
from navgym.core.compile import kernel, part
from navgym.core.regimes import sequence
from navgym.core.seeds import split_of
from navgym.deck.model import DeckModel
from navgym.deck.recording import DualIMURecording
from navgym.deck.scenarios import DeckScenario
from navgym.inertial.earth import EARTH_RATE, GRAVITY
from navgym.inertial.flexure import ARCMIN
from navgym.inertial.imu_simulation import add_errors
from navgym.inertial.strapdown import local_rate

STREAM = 0xD0  # first word of every deck seed sequence


def simulate(scenario: DeckScenario, seeds: Sequence[int]) -> list[DualIMURecording]:
    """One recording per seed; the same seed gives the same recording in any company."""
    return [_one(scenario, int(seed)) for seed in seeds]


def _one(scenario: DeckScenario, seed: int) -> DualIMURecording:
    split_of(seed)
    streams = np.random.SeedSequence([STREAM, seed]).spawn(7)
    flexing, main, sub, slams, glitches, outliers, order = (
        np.random.default_rng(s) for s in streams
    )
    T, s = scenario.samples, scenario.samples_per_step
    dwell = [max(1, round(d * scenario.rate / s)) for d in scenario.dwell]
    steps = sequence(len(scenario.regimes), (dwell[0], dwell[1]), T // s, order)
    regime = np.repeat(steps, s)
    jumps, impulse_variance = _slams(scenario, regime, slams)
    theta, rate = _flexure(scenario, regime, jumps, flexing)
    motion = np.empty((4, T, 3))
    _move(scenario, theta, rate, motion)
    add_errors(motion[0], motion[1], scenario.main, scenario.rate, main)
    add_errors(motion[2], motion[3], scenario.sub, scenario.rate, sub)
    motion[2] += _outliers(scenario, regime, outliers)
    disturbance, variance = _glitches(scenario, steps, glitches)
    lever = np.array(scenario.lever_arm) + scenario.lever_error * order.standard_normal(3)
    believed = scenario.model
    meta = {"scenario": f"deck/{scenario.name}", "regimes": [r.name for r in scenario.regimes]}
    return DualIMURecording(
        np.arange(1, T + 1) / scenario.rate,
        main_angle=motion[0],
        main_velocity=motion[1],
        sub_angle=motion[2],
        sub_velocity=motion[3],
        model=DeckModel(believed.flexure, lever, s),
        theta=theta[1:],
        theta_rate=rate[1:],
        static=np.array(scenario.static) * ARCMIN,
        regime=regime,
        disturbance=disturbance,
        disturbance_variance=variance,
        impulse_variance=impulse_variance.reshape(T // s, s, 3).sum(axis=1),
        impulse_left=_left(impulse_variance.reshape(T // s, s, 3)),
        true_flexure=_flexure_rows(scenario)[steps],
        meta=meta | {"seed": seed},
        check_units=False,
    )


def _flexure_rows(scenario: DeckScenario) -> Array:
    """(regimes, 9): 2μ, b², σ of each."""
    models = [r.flexure for r in scenario.regimes]
    return np.array([[*m.damping, *m.stiffness, *m.sigma] for m in models])


def _slams(
    scenario: DeckScenario, regime: NDArray[np.int64], rng: np.random.Generator
) -> tuple[Array, Array]:
    """Jumps of θ̇ at each IMU sample (T, 3), rad/s, and the variance that they were drawn with."""
    rate = np.array([r.slam_rate for r in scenario.regimes])
    deviation = np.zeros((len(regime), 3))
    hit = np.flatnonzero(rng.random(len(regime)) < rate[regime] / scenario.rate)
    sizes = np.array([r.slam_size * r.flexure.rate_sigma for r in scenario.regimes])
    deviation[hit] = sizes[regime[hit]]
    jumps = deviation.copy()
    jumps[hit] *= rng.standard_normal((len(hit), 3))
    return jumps, deviation**2


def _left(variance: Array) -> Array:
    """(K, 1) share of each step that was left after its jumps, whose variances (K, s, 3) count."""
    samples = variance.shape[1]
    each = variance.sum(axis=2)
    left = 1.0 - np.arange(1, samples + 1) / samples
    found: Array = (each @ left) / np.maximum(each.sum(axis=1), 1e-300)
    return found[:, None]


def _flexure(
    scenario: DeckScenario, regime: NDArray[np.int64], jumps: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """True θ and θ̇ at t = 0 and after each IMU sample, (T + 1, 3) each."""
    h = 1.0 / scenario.rate
    models = [r.flexure for r in scenario.regimes]
    transitions = np.stack([m.transition(h) for m in models])
    roots = np.linalg.cholesky(np.stack([m.process_noise(h) for m in models]))
    theta, rate = (np.empty((len(regime) + 1, 3)) for _ in range(2))
    start = rng.standard_normal((2, 3))  # from the stationary law: θ(0) = 0 would leak the split
    theta[0], rate[0] = start * (models[regime[0]].sigma, models[regime[0]].rate_sigma)
    noise = rng.standard_normal((len(regime), 3, 2))
    flex(transitions, roots, regime, noise, jumps, theta, rate)
    return theta, rate


@kernel
def flex(transitions, roots, regime, noise, jumps, theta, rate):
    """Exact recursion of the second-order Markov process (replaces IDAM eq. 80)."""
    for k in range(len(regime)):
        g = regime[k]
        for a in range(3):
            F, L = transitions[g, a], roots[g, a]
            x, v, n = theta[k, a], rate[k, a], noise[k, a]
            theta[k + 1, a] = F[0, 0] * x + F[0, 1] * v + L[0, 0] * n[0]
            rate[k + 1, a] = F[1, 0] * x + F[1, 1] * v + L[1, 0] * n[0] + L[1, 1] * n[1]
            rate[k + 1, a] += jumps[k, a]


def _move(scenario: DeckScenario, theta: Array, rate: Array, out: Array) -> None:
    """Fill `out` (4, T, 3) with error-free increments: main and sub, angle and velocity each."""
    static = np.array(scenario.static) * ARCMIN
    turn = Rotation.from_rotvec(static)
    lever = np.array(scenario.lever_arm)
    if scenario.static_lever:
        lever = turn.apply(lever)
    ship = np.array(
        [
            *np.radians(scenario.sway), *scenario.sway_rate, math.radians(scenario.heading),
            math.radians(scenario.latitude), scenario.speed,
        ]
    )  # fmt: skip
    sail(ship, lever, turn.as_matrix(), 1.0 / scenario.rate, theta, rate, out)


@part
def swing_on(phase, half):
    """Turn the sway's phases (3, 2), cosine and sine, on by half a sample."""
    for i in range(3):
        c, s = phase[i, 0], phase[i, 1]
        phase[i, 0] = c * half[i, 0] - s * half[i, 1]
        phase[i, 1] = s * half[i, 0] + c * half[i, 1]


@part
def attend(ship, phase, omega, force):
    """Write the main IMU's inertial rate and specific force, in its own axes.

    Local frame north-east-down, body axes forward-starboard-down; pitch, roll and heading sway
    (IDAM eq. 79, corrected) while the ship keeps its speed over ground along the mean heading.
    """
    pitch, roll = ship[0] * phase[0, 1], ship[1] * phase[1, 1]
    heading = ship[6] + ship[2] * phase[2, 1]
    pitch_rate = ship[0] * ship[3] * phase[0, 0]
    roll_rate = ship[1] * ship[4] * phase[1, 0]
    heading_rate = ship[2] * ship[5] * phase[2, 0]
    st, ct, sr, cr = math.sin(pitch), math.cos(pitch), math.sin(roll), math.cos(roll)
    sh, ch = math.sin(heading), math.cos(heading)
    north, east = ship[8] * math.cos(ship[6]), ship[8] * math.sin(ship[6])
    sl, cl = math.sin(ship[7]), math.cos(ship[7])
    wn, we, wd = local_rate(sl, cl, north, east)
    # specific force in the local frame: Coriolis less gravity
    un, ue, ud = wn + EARTH_RATE * cl, we, wd - EARTH_RATE * sl
    fn, fe, fd = -ud * east, ud * north, un * east - ue * north - GRAVITY
    for i in range(3):
        if i == 0:
            a, b, c = ct * ch, ct * sh, -st
            own = roll_rate - heading_rate * st
        elif i == 1:
            a, b, c = sr * st * ch - cr * sh, sr * st * sh + cr * ch, sr * ct
            own = pitch_rate * cr + heading_rate * ct * sr
        else:
            a, b, c = cr * st * ch + sr * sh, cr * st * sh - sr * ch, cr * ct
            own = -pitch_rate * sr + heading_rate * ct * cr
        omega[i] = a * wn + b * we + c * wd + own
        force[i] = a * fn + b * fe + c * fd


@part
def rotate_back(v, w, out):
    """out = Exp(−v) w for a small rotation vector v, to third order."""
    x0, x1, x2 = v[1] * w[2] - v[2] * w[1], v[2] * w[0] - v[0] * w[2], v[0] * w[1] - v[1] * w[0]
    y0, y1, y2 = v[1] * x2 - v[2] * x1, v[2] * x0 - v[0] * x2, v[0] * x1 - v[1] * x0
    out[0] = w[0] - x0 + 0.5 * y0
    out[1] = w[1] - x1 + 0.5 * y1
    out[2] = w[2] - x2 + 0.5 * y2
    third = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) / 6.0  # v × (v × x) = −|v|² x for x ⊥ v
    out[0] += third * x0
    out[1] += third * x1
    out[2] += third * x2


@part
def swing(omega, theta, rate, lever, u):
    """u = ω × r + ṙ with r = r0 + θ × r0: velocity of the sub IMU relative to the main (IDAM eq. 7)."""
    r0, r1, r2 = lever[0], lever[1], lever[2]
    a = r0 + theta[1] * r2 - theta[2] * r1
    b = r1 + theta[2] * r0 - theta[0] * r2
    c = r2 + theta[0] * r1 - theta[1] * r0
    u[0] = omega[1] * c - omega[2] * b + rate[1] * r2 - rate[2] * r1
    u[1] = omega[2] * a - omega[0] * c + rate[2] * r0 - rate[0] * r2
    u[2] = omega[0] * b - omega[1] * a + rate[0] * r1 - rate[1] * r0


@kernel
def sail(ship, lever, static, h, theta, rate, out):
    """Error-free increments (4, T, 3): main angle, main velocity, sub angle, sub velocity."""
    before, middle, after = np.empty((2, 3)), np.empty((2, 3)), np.empty((2, 3))
    u0, u1, mean = np.empty(3), np.empty(3), np.empty(3)
    turned, moved, bent = np.empty(3), np.empty(3), np.empty(3)
    phase, half = np.zeros((3, 2)), np.zeros((3, 2))
    for i in range(3):
        phase[i, 0] = 1.0
        half[i, 0], half[i, 1] = math.cos(0.5 * h * ship[3 + i]), math.sin(0.5 * h * ship[3 + i])
    attend(ship, phase, before[0], before[1])
    swing(before[0], theta[0], rate[0], lever, u0)
    for k in range(out.shape[1]):
        swing_on(phase, half)
        attend(ship, phase, middle[0], middle[1])
        swing_on(phase, half)
        attend(ship, phase, after[0], after[1])
        swing(after[0], theta[k + 1], rate[k + 1], lever, u1)
        a, b = theta[k], theta[k + 1]
        for i in range(3):
            for j in range(2):
                simpson = (before[j, i] + 4.0 * middle[j, i] + after[j, i]) * h / 6.0
                out[j, k, i] = simpson
            mean[i] = 0.5 * (a[i] + b[i])
        rotate_back(mean, out[0, k], turned)
        for i in range(3):
            n, m = (i + 1) % 3, (i + 2) % 3
            # the body rate of Exp(θ) is θ̇ − θ × θ̇/2 + θ × (θ × θ̇)/6
            turned[i] += b[i] - a[i] - 0.5 * (a[n] * b[m] - a[m] * b[n])
            along = mean[n] * (b[n] - a[n]) + mean[m] * (b[m] - a[m])
            square = mean[n] * mean[n] + mean[m] * mean[m]
            turned[i] += (mean[i] * along - square * (b[i] - a[i])) / 6.0
            moved[i] = out[1, k, i] + u1[i] - u0[i]
            moved[i] += 0.5 * h * (before[0, n] * u0[m] - before[0, m] * u0[n])
            moved[i] += 0.5 * h * (after[0, n] * u1[m] - after[0, m] * u1[n])
        rotate_back(mean, moved, bent)
        for i in range(3):
            for j in range(2):
                out[2 + j, k, i] = 0.0
            for n in range(3):
                out[2, k, i] += static[n, i] * turned[n]
                out[3, k, i] += static[n, i] * bent[n]
        for i in range(3):
            for j in range(2):
                before[j, i] = after[j, i]
            u0[i] = u1[i]


def _glitches(
    scenario: DeckScenario, steps: NDArray[np.int64], rng: np.random.Generator
) -> tuple[Array, Array]:
    """Errors of the transmitted velocities and rates (K, 6), and their true variances."""
    rate = np.array([r.glitch_rate for r in scenario.regimes])[steps]
    sizes = np.array([[r.glitch_velocity] * 3 + [r.glitch_rate_size] * 3 for r in scenario.regimes])
    hit = rng.random((len(steps), 6)) < rate[:, None]
    deviation = np.where(hit, sizes[steps], 0.0)
    return deviation * rng.standard_normal((len(steps), 6)), deviation**2


def _outliers(scenario: DeckScenario, regime: NDArray[np.int64], rng: np.random.Generator) -> Any:
    """Wrong angle increments of the sub IMU (T, 3), or 0 where no regime has any."""
    rate = np.array([r.outlier_rate for r in scenario.regimes])
    if not rate.any():
        return 0.0
    size = np.array([r.outlier_size for r in scenario.regimes])[regime, None] / scenario.rate
    hit = rng.random((len(regime), 3)) < rate[regime, None]
    return np.where(hit, size * rng.standard_normal((len(regime), 3)), 0.0)
