"""The motion of a simulated vehicle, at the IMU's rate: legs and turns, dives, waves, a wandering speed.

What the mission wants is numpy; what the vehicle does about it is a compiled recursion. Turn rate, speed and
pitch follow their targets with lags, so that forces are those of a hull.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from navgym.core.checks import Array
from navgym.core.compile import kernel
from navgym.inertial.rotation import euler_matrix
from navgym.ins.scenarios import InsScenario
from navgym.ins.speed import SMOOTHING, SpeedProcess

TURN_LAG, SPEED_LAG, PITCH_LAG = 1.5, 6.0, 3.0  # s
DIVE_LAG = 12.0  # s, in which a vehicle would be at its depth if pitch were free
STEEPEST = math.radians(15.0)
SLOWEST = 0.2  # m/s
WAVES, FADES = 3, 15.0  # sinusoids per angle; m, in which waves fade by e
PITCH_OF_ROLL, HEADING_OF_ROLL, HEAVE_OF_ROLL = 0.4, 0.2, 1.0  # rad per rad; m/s per rad
CROSS = (20.0, 40.0)  # m between legs
STAY_DEEP = (2, 5)  # legs at one depth


@dataclass(frozen=True, eq=False)
class Track:
    """The truth at t = 0 and after each of T IMU samples.

    Args:
        velocity: (T + 1, 3) NED, m/s.
        attitude: (T + 1, 3, 3) body to NED.
        angles: (T + 1, 3) roll, pitch, heading, rad; heading within ±π.
        current: (T + 1, 2) of the water, north and east, m/s.
        depth: m, at the start.
    """

    velocity: Array
    attitude: Array
    angles: Array
    current: Array
    depth: float


def sail(scenario: InsScenario, rng: np.random.Generator) -> Track:
    """Sail a mission; every recording draws the same numbers in the same order, whatever its length."""
    T, h = scenario.samples, 1.0 / scenario.rate
    process = scenario.process
    plan, noise, sea = (np.random.default_rng(s) for s in rng.spawn(3))
    wanted = _plan(scenario, plan)
    start = plan.standard_normal(2), float(plan.uniform(-math.pi, math.pi))
    white = noise.standard_normal((T, 4))
    waves = _waves(scenario, sea)
    water = scenario.current * sea.standard_normal(2)
    velocity, angles, current = np.empty((T + 1, 3)), np.empty((T + 1, 3)), np.empty((T + 1, 2))
    attitude = np.empty((T + 1, 3, 3))
    motion(
        wanted, white, waves, _row(process), h, start[1], start[0], water,
        np.array([scenario.current, scenario.current_time]), velocity, attitude, angles, current,
    )  # fmt: skip
    return Track(velocity, attitude, angles, current, float(wanted[0, 2]))


def _row(p: SpeedProcess) -> Array:
    return np.array(
        [
            p.surge_deviation, p.surge_time, p.turn_loss, p.turn_time, p.side_slip, p.sway_deviation,
            p.sway_time,
        ]
    )  # fmt: skip


def _plan(scenario: InsScenario, rng: np.random.Generator) -> Array:
    """Turn rate (rad/s), speed and depth (T + 1, 3) that the mission wants: a lawn-mower."""
    T, rate = scenario.samples, scenario.rate
    wanted, k, side, leg = np.empty((T + 1, 3)), 0, 1.0, 0
    turn = math.radians(scenario.turn_rate)
    quarter = max(1, round(rate * 0.5 * math.pi / turn))
    depth, until = float(rng.uniform(*scenario.depths)), 0
    k = -int(rng.uniform(0.0, 0.7) * scenario.legs[0] / scenario.speeds[0] * rate)  # under way
    while k <= T:
        if leg >= until:
            depth = float(rng.uniform(*scenario.depths))
            until = leg + int(rng.integers(STAY_DEEP[0], STAY_DEEP[1] + 1))
        speed = float(rng.choice(scenario.speeds))
        long, short = (
            max(1, round(rate * float(rng.uniform(*d)) / speed)) for d in (scenario.legs, CROSS)
        )
        for samples, r in (
            (long, 0.0),
            (quarter, side * turn),
            (short, 0.0),
            (quarter, side * turn),
        ):
            wanted[max(k, 0) : max(k + samples, 0)] = r, speed, depth
            k += samples
        side, leg = -side, leg + 1
    return wanted


def _waves(scenario: InsScenario, rng: np.random.Generator) -> Array:
    """Amplitude (rad), angular rate and phase of the sinusoids of roll, pitch, heading: (3, WAVES, 3)."""
    found = np.empty((3, WAVES, 3))
    size = math.radians(scenario.waves) * math.sqrt(2.0 / WAVES)
    for i, share in enumerate((1.0, PITCH_OF_ROLL, HEADING_OF_ROLL)):
        found[i, :, 0] = size * share * rng.uniform(0.5, 1.5, WAVES)
        found[i, :, 1] = 2.0 * math.pi / rng.uniform(5.0, 10.0, WAVES)
        found[i, :, 2] = rng.uniform(0.0, 2.0 * math.pi, WAVES)
    return found


@kernel
def motion(
    wanted,
    white,
    waves,
    process,
    h,
    heading,
    wander,
    water,
    flow,
    velocity,
    attitude,
    angles,
    current,
):
    """Fill velocity, attitude, angles and current (T + 1 rows).

    Args:
        wanted: (T + 1, 3) turn rate, speed, depth.
        white: (T, 4) unit noise: of surge, sway, and the current.
        waves: (3, n, 3).
        process: (7,) of the speed.
        h: s.
        heading: rad, at the start.
        wander: (2,) where surge and sway are at the start, in standard deviations.
        water: (2,) current at the start, m/s.
        flow: deviation and time of the current.
        velocity: (T + 1, 3) to be filled.
        attitude: (T + 1, 3, 3).
        angles: (T + 1, 3).
        current: (T + 1, 2).
    """
    surge_sd, surge_time, loss, loss_time, slip, sway_sd, sway_time = process
    rate, speed, depth, pitch, lost = wanted[0, 0], wanted[0, 1], wanted[0, 2], 0.0, 0.0
    x, y = surge_sd * wander[0], sway_sd * wander[1]
    x1, x2, y1, y2 = x, x, y, y
    keep_x, keep_y = math.exp(-h / surge_time), math.exp(-h / sway_time)
    new_x, new_y = surge_sd * math.sqrt(1.0 - keep_x**2), sway_sd * math.sqrt(1.0 - keep_y**2)
    keep_c = math.exp(-h / flow[1])
    new_c = flow[0] * math.sqrt(1.0 - keep_c**2)
    smooth, felt = h / SMOOTHING, h / loss_time
    c0, c1 = water[0], water[1]
    for k in range(len(velocity)):
        fade = math.exp(-max(depth, 0.0) / FADES)
        swing0, swing1, swing2 = 0.0, 0.0, 0.0
        for w in range(waves.shape[1]):
            swing0 += waves[0, w, 0] * math.sin(waves[0, w, 1] * k * h + waves[0, w, 2])
            swing1 += waves[1, w, 0] * math.sin(waves[1, w, 1] * k * h + waves[1, w, 2])
            swing2 += waves[2, w, 0] * math.sin(waves[2, w, 1] * k * h + waves[2, w, 2])
        roll = fade * swing0 + 0.3 * rate
        tilt = pitch + fade * swing1
        yaw = heading + fade * swing2
        yaw -= 2.0 * math.pi * math.floor(yaw / (2.0 * math.pi) + 0.5)
        euler_matrix(roll, tilt, yaw, attitude[k])
        u = max(speed * (1.0 + x2) - lost, SLOWEST)
        v = speed * y2 - slip * rate
        w = HEAVE_OF_ROLL * fade * swing1
        for i in range(3):
            velocity[k, i] = attitude[k, i, 0] * u + attitude[k, i, 1] * v + attitude[k, i, 2] * w
        angles[k, 0], angles[k, 1], angles[k, 2] = roll, tilt, yaw
        current[k, 0], current[k, 1] = c0, c1
        if k == len(velocity) - 1:
            break
        depth += h * velocity[k, 2]
        rate += h / TURN_LAG * (wanted[k, 0] - rate)
        heading += h * rate
        speed += h / SPEED_LAG * (wanted[k, 1] - speed)
        climb = (depth - wanted[k, 2]) / (DIVE_LAG * u)
        climb = min(max(climb, -STEEPEST), STEEPEST)
        pitch += h / PITCH_LAG * (climb - pitch)
        lost += felt * (loss * rate * rate - lost)
        x = keep_x * x + new_x * white[k, 0]
        y = keep_y * y + new_y * white[k, 1]
        x1, y1 = x1 + smooth * (x - x1), y1 + smooth * (y - y1)
        x2, y2 = x2 + smooth * (x1 - x2), y2 + smooth * (y1 - y2)
        c0 = keep_c * c0 + new_c * white[k, 2]
        c1 = keep_c * c1 + new_c * white[k, 3]
