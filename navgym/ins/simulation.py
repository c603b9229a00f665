"""INS recordings: a vehicle on a mission, its IMU, and what its other sensors make of it.

A kinematic truth at the IMU's rate, the exact inverse of the mechanisation (`navgym.inertial`), errors
added to its increments, and sensors that sample the truth. Each recording draws from generators of its own
for mission, IMU, each sensor, regimes and start, so that a change of one leaves the others' numbers as
they were.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.seeds import split_of
from navgym.inertial.earth import radii_of_curvature
from navgym.inertial.mechanization import increments
from navgym.ins.imu_grades import ImuGrade
from navgym.ins.layout import ALPHA, BA, BG, PHI, STATES, C, M, R, S, V
from navgym.ins.mission import sail
from navgym.ins.model import InsModel
from navgym.ins.recording import Aiding, InertialRecording
from navgym.ins.scenarios import InsScenario

STREAM = 0xE0  # first word of every INS seed sequence
_STREAMS = (
    "mission",
    "imu",
    "dvl",
    "depth",
    "magnetometer",
    "fix",
    "water",
    "order",
    "start",
    "sensors",
)


def simulate(scenario: InsScenario, seeds: Sequence[int]) -> list[InertialRecording]:
    """One recording per seed; the same seed gives the same recording in any company."""
    return [_one(scenario, int(seed)) for seed in seeds]


def _one(scenario: InsScenario, seed: int) -> InertialRecording:
    split_of(seed)
    words = np.random.SeedSequence([STREAM, seed]).spawn(len(_STREAMS))
    rngs = {name: np.random.default_rng(w) for name, w in zip(_STREAMS, words, strict=True)}
    h, T, per = 1.0 / scenario.rate, scenario.samples, scenario.samples_per_step
    model = scenario.model
    track = sail(scenario, rngs["mission"])
    place = np.array([model.latitude, model.longitude, -track.depth])
    origin = place.copy()
    angle, velocity, places = (np.empty((T, 3)) for _ in range(3))
    increments(track.velocity, track.attitude, h, place, angle, velocity, places)
    position = local(places, origin)
    regime, scale = _regimes(scenario, rngs["order"])
    rate = angle / h
    constants = _constants(scenario, rngs["sensors"])
    bias = add_imu_errors(angle, velocity, scenario.imu, h, np.repeat(scale, per), rngs["imu"])
    truth = np.empty((T // per, STATES))
    ends = np.arange(per - 1, T, per)
    truth[:, R], truth[:, V] = position[ends], track.velocity[ends + 1]
    truth[:, PHI] = track.angles[ends + 1]
    truth[:, BG], truth[:, BA] = bias[0][ends], bias[1][ends]
    truth[:, M], truth[:, S], truth[:, ALPHA] = constants["M"], constants["s"], constants["alpha"]
    truth[:, C] = track.current[ends + 1]
    world = _World(scenario, track, position, rate, regime, constants)
    aiding, scales = world.sense(rngs)
    meta = {"scenario": f"ins/{scenario.name}", "regimes": [r.name for r in scenario.regimes]}
    return InertialRecording(
        np.arange(1, T + 1) * h,
        angle,
        velocity,
        aiding=aiding,
        model=_start(model, track, origin, rngs["start"]),
        truth=truth,
        regime=regime,
        noise_scales=scales,
        imu_scale=scale,
        meta=meta | {"seed": seed},
        check_units=False,
    )


def local(places: Array, origin: Array) -> Array:
    """Latitudes, longitudes (rad) and heights (T, 3) as metres north, east, down of `origin` (3,)."""
    meridian, across = radii_of_curvature(float(origin[0]))
    metres = [meridian + origin[2], (across + origin[2]) * math.cos(origin[0]), -1.0]
    found: Array = (places - origin) * metres
    return found


def _regimes(scenario: InsScenario, rng: np.random.Generator) -> tuple[NDArray[np.int64], Array]:
    """Label (K,) and scale of the IMU's white noise (K,) of each filter step."""
    per = scenario.samples_per_step / scenario.rate
    count, steps = len(scenario.regimes), scenario.samples // scenario.samples_per_step
    labels = np.zeros(steps, dtype=np.int64)
    k = steps if count == 1 else 0
    now = 0  # a mission begins in calm: who calibrates in an anomaly knows no better
    while k < steps:
        dwell = scenario.regimes[now].dwell or scenario.dwell
        low, high = (max(1, round(d / per)) for d in dwell)
        stay = int(rng.integers(low, high + 1))
        labels[k : k + stay] = now
        k += stay
        now = (now + 1 + int(rng.integers(count - 1))) % count
    return labels, np.array([r.imu_scale for r in scenario.regimes])[labels]


def _constants(scenario: InsScenario, rng: np.random.Generator) -> dict[str, Any]:
    """Hard iron, scale and misalignment of the Doppler log: drawn once per recording."""
    draws = rng.standard_normal(5)
    known = 0.0 if scenario.calibrated else 1.0
    return {
        "M": scenario.hard_iron * draws[:3],
        "s": known * scenario.dvl_scale * draws[3],
        "alpha": known * math.radians(scenario.dvl_misalignment) * draws[4],
    }


def add_imu_errors(
    angle: Array, velocity: Array, grade: ImuGrade, h: float, scale: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Spoil increments (T, 3) in place; returns the biases (T, 3) of gyros and accelerometers."""
    gyro, walk, accelerometer, shake, drift, sway = grade.si
    biases = []
    for values, constant, white, wander in (
        (angle, gyro, walk, drift), (velocity, accelerometer, shake, sway)
    ):  # fmt: skip
        steps = wander * math.sqrt(h) * rng.standard_normal(values.shape)
        bias = constant * rng.standard_normal(3) + np.cumsum(steps, axis=0)
        noise = white * math.sqrt(h) * np.sqrt(scale)[:, None] * rng.standard_normal(values.shape)
        np.add(values, h * bias + noise, out=values)
        biases.append(bias)
    return biases[0], biases[1]


def _start(model: InsModel, track: Any, origin: Array, rng: np.random.Generator) -> InsModel:
    """The model with a start that errs as it says."""
    draws = rng.standard_normal(9)
    meridian, across = radii_of_curvature(float(origin[0]))
    metres = np.array([meridian + origin[2], (across + origin[2]) * math.cos(origin[0]), -1.0])
    start = origin + model.position_deviation * draws[:3] / metres
    tilt = np.array([model.tilt_deviation, model.tilt_deviation, model.heading_deviation])
    C_true = track.attitude[0]
    turn = tilt * draws[6:]
    C = rotation(-turn) @ C_true
    angles = (
        math.atan2(C[2, 1], C[2, 2]), -math.asin(min(max(C[2, 0], -1.0), 1.0)), math.atan2(C[1, 0], C[0, 0]),
    )  # fmt: skip
    return model.replace(
        latitude=float(start[0]),
        longitude=float(start[1]),
        height=float(start[2]),
        origin=tuple(origin.tolist()),
        velocity=track.velocity[0] + model.velocity_deviation * draws[3:6],
        attitude=angles,
    )


def rotation(r: Array) -> Array:
    """exp([r×]) of a rotation vector (3,)."""
    size = float(np.linalg.norm(r))
    X = np.array([[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]])
    a = math.sin(size) / size if size > 1e-8 else 1.0
    b = (1.0 - math.cos(size)) / size**2 if size > 1e-8 else 0.5
    found: Array = np.eye(3) + a * X + b * X @ X
    return found


class _World:
    """The truth that sensors sample.

    Args:
        scenario: what is on board.
        track: the truth at t = 0 and after each IMU sample.
        position: (T, 3) NED of the origin, after each IMU sample.
        rate: (T, 3) true mean rates.
        regime: (K,) labels.
        constants: of the sensors.
    """

    def __init__(
        self, scenario: InsScenario, track: Any, position: Array, rate: Array,
        regime: NDArray[np.int64], constants: dict[str, Any],
    ) -> None:  # fmt: skip
        self.scenario, self.track, self.position, self.constants = (
            scenario, track, position, constants,
        )  # fmt: skip
        self.rate, self.regime = rate, regime
        self.C = track.attitude[1:]

    def sense(
        self, rngs: dict[str, np.random.Generator]
    ) -> tuple[dict[str, Aiding], dict[str, Array]]:
        """Every sensor's measurements, and the true scale of each one's variance."""
        aiding: dict[str, Aiding] = {}
        scales: dict[str, Array] = {}
        for name in self.scenario.sensors:
            aiding[name], scales[name] = getattr(self, f"_{name}")(rngs[name])
        return aiding, scales

    def _moments(self, period: float) -> tuple[NDArray[np.int64], Array]:
        """Indices of the IMU samples that a sensor measures after, and the times."""
        every = max(1, round(period * self.scenario.rate))
        at = np.arange(every - 1, len(self.position), every)
        return at, (at + 1) / self.scenario.rate

    def _of_regime(self, name: str, at: NDArray[np.int64]) -> Array:
        each = np.array([getattr(r, name) for r in self.scenario.regimes])
        found: Array = each[self.regime[at // self.scenario.samples_per_step]]
        return found

    def _spoiled(
        self, kind: str, at: NDArray[np.int64], exact: Array, noise: Any, rng: np.random.Generator
    ) -> tuple[Array, NDArray[np.bool_], Array]:
        """Values, losses and scales of a sensor whose regimes are called `kind`_…"""
        scale = self._of_regime(f"{kind}_scale", at)
        wild = rng.random(len(at)) < self._of_regime(f"{kind}_outliers", at)
        scale = np.where(wild, scale * self._of_regime(f"{kind}_outlier_scale", at), scale)
        lost = rng.random(len(at)) < self._of_regime(f"{kind}_loss", at)
        error = np.asarray(noise) * rng.standard_normal(exact.shape)
        return exact + np.sqrt(scale)[:, None] * error, lost, scale

    def _dvl(self, rng: np.random.Generator) -> tuple[Aiding, Array]:
        s = self.scenario
        at, time = self._moments(s.dvl_period)
        after = np.minimum(at + 1, len(self.rate) - 1)
        rate = 0.5 * (self.rate[at] + self.rate[after])
        v = np.einsum("kji,kj->ki", self.C[at], self.track.velocity[at + 1])
        v = v + np.cross(rate, np.array(s.dvl_lever))
        turned = np.stack([v[:, 0] + self.constants["alpha"] * v[:, 1], v[:, 1] - self.constants["alpha"] * v[:, 0], v[:, 2]], axis=-1)  # fmt: skip
        values, lost, scale = self._spoiled("dvl", at, (1.0 + self.constants["s"]) * turned, s.dvl_noise, rng)  # fmt: skip
        for begin, length in s.outages:
            lost |= (time >= begin) & (time < begin + length)
        return Aiding(time, values, lost), scale

    def _fix(self, rng: np.random.Generator) -> tuple[Aiding, Array]:
        at, time = self._moments(self.scenario.fix_period)
        found = self._spoiled("fix", at, self.position[at], self.scenario.fix_noise, rng)
        return Aiding(time, found[0], found[1]), found[2]

    def _depth(self, rng: np.random.Generator) -> tuple[Aiding, Array]:
        at, time = self._moments(self.scenario.depth_period)
        noise = self.scenario.depth_noise * rng.standard_normal((len(at), 1))
        return Aiding(time, self.position[at, 2:] + noise), np.ones(len(at))

    def _magnetometer(self, rng: np.random.Generator) -> tuple[Aiding, Array]:
        s = self.scenario
        at, time = self._moments(s.magnetometer_period)
        size = self._of_regime("anomaly", at)
        entered = np.r_[True, np.diff(self.regime[at // s.samples_per_step]) != 0]
        directions = rng.standard_normal((len(at), 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        which = np.maximum.accumulate(np.where(entered, np.arange(len(at)), 0))
        anomaly = size[:, None] * directions[which]  # one direction from entry to exit
        field = np.array(s.magnetic_field) + anomaly
        exact = np.einsum("kji,kj->ki", self.C[at], field) + self.constants["M"]
        noise = s.magnetometer_noise * rng.standard_normal(exact.shape)
        # as a variance: what an anomaly of that size in an unknown direction adds to each axis
        return Aiding(time, exact + noise), 1.0 + size**2 / 3.0 / s.magnetometer_noise**2

    def _water(self, rng: np.random.Generator) -> tuple[Aiding, Array]:
        at, time = self._moments(self.scenario.water_period)
        v = self.track.velocity[at + 1].copy()
        v[:, :2] -= self.track.current[at + 1]
        body = np.einsum("kji,kj->ki", self.C[at], v)
        noise = self.scenario.water_noise * rng.standard_normal(body.shape)
        return Aiding(time, body + noise), np.ones(len(at))
