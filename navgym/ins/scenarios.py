"""Missions of an AUV that navigates by itself: what is on board, and what happens to it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from navgym.core.checks import one_of, positive_int, real_array, span, within
from navgym.ins.imu_grades import GRADES, ImuGrade
from navgym.ins.model import AidingModel, InsModel
from navgym.ins.speed import PROCESSES, SpeedProcess

Pair = tuple[float, float]
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class InsRegime:
    """What happens to sensors for a while; scales multiply variances.

    Args:
        name: for tables and plots.
        dvl_scale: of the Doppler log's noise.
        dvl_loss: share of its measurements that are lost.
        dvl_outliers: share of its measurements whose noise is `dvl_outlier_scale` times as large.
        dvl_outlier_scale: as a variance.
        fix_scale: of a position fix's noise.
        fix_loss: share of fixes that are lost.
        fix_outliers: share of fixes whose noise is `fix_outlier_scale` times as large.
        fix_outlier_scale: as a variance.
        anomaly: size of a magnetic disturbance, µT.
        imu_scale: of the IMU's white noise (vibration).
        dwell: s, least and largest time in it; None: the scenario's.
    """

    name: str
    dvl_scale: float = 1.0
    dvl_loss: float = 0.0
    dvl_outliers: float = 0.0
    dvl_outlier_scale: float = 2500.0
    fix_scale: float = 1.0
    fix_loss: float = 0.0
    fix_outliers: float = 0.0
    fix_outlier_scale: float = 225.0
    anomaly: float = 0.0
    imu_scale: float = 1.0
    dwell: Pair | None = None

    def __post_init__(self) -> None:
        if self.dwell is not None:
            span(f"dwell of regime {self.name!r}", self.dwell, 0.0, above=True)
        for f in dataclasses.fields(self)[1:-1]:
            share = f.name.endswith(("loss", "outliers"))
            top = {"high": 1.0} if share else {}
            positive = f.name.endswith("scale")
            label = f"{f.name} of regime {self.name!r}"
            within(label, getattr(self, f.name), 0.0, above=positive, **top)


CALM = InsRegime("calm")
ROUGH = InsRegime("rough", dvl_scale=25.0, dvl_loss=0.5)
FISH = InsRegime("fish", dvl_outliers=0.25)
NO_LOCK = InsRegime("no lock", dvl_loss=1.0)
MULTIPATH = InsRegime("multipath", fix_outliers=0.35, fix_loss=0.3)
THERMOCLINE = InsRegime("thermocline", fix_scale=25.0, fix_loss=0.5)
ANOMALY = InsRegime("anomaly", anomaly=8.0, dwell=(20.0, 60.0))
VIBRATION = InsRegime("vibration", imu_scale=100.0)


@dataclass(frozen=True)
class InsScenario:
    """One member of the catalogue; every field can be overridden.

    The mission is a lawn-mower: legs, with turns of 90° between, at depths that change now and then.

    Args:
        name: its name without the "ins/" in front.
        summary: one line for listings.
        duration: s per recording.
        rate: IMU samples per second.
        samples_per_step: IMU samples per filter step.
        grade: of the IMU, "navigation", "tactical", "mems", or an `ImuGrade`.
        speeds: m/s, of which each leg takes one.
        speed_process: "fitted" (to real tracks), "steady", or a `SpeedProcess`.
        legs: m, shortest and longest.
        turn_rate: degrees per second.
        depths: m, least and largest.
        waves: degrees, standard deviation of the roll near the surface; it fades with depth.
        current: m/s, standard deviation of a component; it wanders over `current_time`.
        current_time: s.
        regimes: conditions that follow one another; the first comes first, then each next is drawn uniformly
            among the others.
        dwell: s, least and largest time in a regime.
        outages: (begin, length), s, in which the Doppler log is silent.
        dvl_period: s between its measurements.
        dvl_noise: m/s, forward, starboard, down.
        dvl_lever: m, from the IMU.
        dvl_scale: standard deviation of its scale error.
        dvl_misalignment: degrees, of its misalignment about the vertical.
        depth_period: s; 0: there is none.
        depth_noise: m.
        fix_period: s; 0: there is none.
        fix_noise: m, north, east, down.
        fix_latency: s.
        magnetometer_period: s; 0: there is none.
        magnetometer_noise: µT.
        hard_iron: µT, standard deviation of each axis.
        water_period: s between velocities through water; 0: there is none.
        water_noise: m/s.
        heading_deviation: degrees, of the heading at the start.
        tilt_deviation: degrees, of roll and pitch at the start, beside what the accelerometers' biases do.
        position_deviation: m, at the start.
        velocity_deviation: m/s, at the start.
        latitude: degrees.
        longitude: degrees.
        magnetic_field: µT, north, east, down.
        calibrated: whether the filter knows the scale and the misalignment of the Doppler log, and has no
            states for them; they are then zero.
        reference: filter parameters that are best fixed ones here (the environment's zero line).
    """

    name: str
    summary: str
    duration: float = 1200.0
    rate: float = 100.0
    samples_per_step: int = 20
    grade: str | ImuGrade = "mems"
    speeds: tuple[float, ...] = (1.5, 0.9)
    speed_process: str | SpeedProcess = "fitted"
    legs: Pair = (250.0, 350.0)
    turn_rate: float = 6.0
    depths: Pair = (5.0, 45.0)
    waves: float = 1.5
    current: float = 0.15
    current_time: float = 1800.0
    regimes: tuple[InsRegime, ...] = (CALM,)
    dwell: Pair = (60.0, 240.0)
    outages: tuple[Pair, ...] = ()
    dvl_period: float = 1.0
    dvl_noise: Triple = (0.01, 0.01, 0.007)
    dvl_lever: Triple = (0.0, 0.0, 0.0)
    dvl_scale: float = 0.003
    dvl_misalignment: float = 0.3
    depth_period: float = 0.2
    depth_noise: float = 0.05
    fix_period: float = 10.0
    fix_noise: Triple = (2.0, 2.0, 2.0)
    fix_latency: float = 0.0
    magnetometer_period: float = 1.0
    magnetometer_noise: float = 0.3
    hard_iron: float = 1.5
    water_period: float = 0.0
    water_noise: float = 0.02
    heading_deviation: float = 2.0
    tilt_deviation: float = 0.05
    position_deviation: float = 1.0
    velocity_deviation: float = 0.05
    latitude: float = 32.8
    longitude: float = 34.9
    magnetic_field: Triple = (29.4, 2.3, 33.5)
    calibrated: bool = False
    reference: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}), hash=False)

    def __post_init__(self) -> None:
        within("rate", self.rate, 0.0, above=True)
        positive_int("samples_per_step", self.samples_per_step)
        within("duration", self.duration, 2.0 * self.samples_per_step / self.rate)
        if not self.regimes or not all(isinstance(r, InsRegime) for r in self.regimes):
            raise ValueError(
                f"regimes must be a tuple of at least one InsRegime, got {self.regimes!r}."
            )
        if isinstance(self.speed_process, str):
            one_of("speed process", self.speed_process, PROCESSES)
        if isinstance(self.grade, str):
            one_of("grade of IMU", self.grade, GRADES)
        if not self.speeds or min(self.speeds) <= 0.0:
            raise ValueError(f"speeds must be positive, got {self.speeds}.")
        for name in ("dwell", "legs", "depths"):
            span(name, getattr(self, name), 0.0, above=True)
        for name in _POSITIVE:
            within(name, getattr(self, name), 0.0, above=True)
        for name in _NOT_NEGATIVE:
            within(name, getattr(self, name), 0.0)
        for name in ("dvl_noise", "dvl_lever", "fix_noise", "magnetic_field"):
            if real_array(name, getattr(self, name)).shape != (3,):
                raise ValueError(f"{name} must be three numbers, got {getattr(self, name)!r}.")
        within("latitude", self.latitude, -85.0, 85.0)
        object.__setattr__(self, "reference", MappingProxyType(dict(self.reference)))

    def __reduce__(self) -> tuple[Any, ...]:
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        values["reference"] = dict(self.reference)
        return _rebuild, (values,)

    def override(self, **fields: Any) -> InsScenario:
        """The same scenario with some fields changed; ValueError for an unknown field."""
        known = [f.name for f in dataclasses.fields(self)]
        for name in fields:
            one_of("scenario field", name, known)
        return dataclasses.replace(self, **fields) if fields else self

    @property
    def imu(self) -> ImuGrade:
        """The IMU on board."""
        return GRADES[self.grade] if isinstance(self.grade, str) else self.grade

    @property
    def process(self) -> SpeedProcess:
        """How the speed wanders."""
        given = self.speed_process
        return PROCESSES[given] if isinstance(given, str) else given

    @property
    def samples(self) -> int:
        """IMU samples per recording, whole filter steps."""
        s = self.samples_per_step
        return round(self.duration * self.rate / s) * s

    @property
    def sensors(self) -> dict[str, AidingModel]:
        """Aiding sensors on board, as the filter believes them."""
        found = {"dvl": AidingModel("dvl", self.dvl_noise, self.dvl_lever)}
        if self.depth_period > 0.0:
            found["depth"] = AidingModel("depth", self.depth_noise)
        if self.magnetometer_period > 0.0:
            found["magnetometer"] = AidingModel("magnetometer", self.magnetometer_noise)
        if self.fix_period > 0.0:
            found["fix"] = AidingModel("fix", self.fix_noise, latency=self.fix_latency)
        if self.water_period > 0.0:
            found["water"] = AidingModel("water", self.water_noise)
        return found

    @property
    def model(self) -> InsModel:
        """What a filter believes, but for where it starts."""
        bias = self.imu.si[2]
        tilt = float(np.hypot(np.radians(self.tilt_deviation), bias / 9.8))
        calibrated = self.calibrated
        return InsModel(
            latitude=float(np.radians(self.latitude)),
            longitude=float(np.radians(self.longitude)),
            imu=self.imu,
            sensors=self.sensors,
            samples_per_step=self.samples_per_step,
            position_deviation=self.position_deviation,
            velocity_deviation=self.velocity_deviation,
            tilt_deviation=tilt,
            heading_deviation=float(np.radians(self.heading_deviation)),
            magnetic_field=self.magnetic_field,
            hard_iron=self.hard_iron,
            dvl_scale=0.0 if calibrated else self.dvl_scale,
            dvl_misalignment=0.0 if calibrated else float(np.radians(self.dvl_misalignment)),
            current=self.current if self.water_period > 0.0 else 0.0,
            current_time=self.current_time,
        )


_POSITIVE = (
    "turn_rate", "current_time", "dvl_period", "depth_noise", "magnetometer_noise", "water_noise",
    "heading_deviation", "tilt_deviation", "position_deviation", "velocity_deviation",
)  # fmt: skip
_NOT_NEGATIVE = (
    "waves", "current", "dvl_scale", "dvl_misalignment", "depth_period", "fix_period", "fix_latency",
    "magnetometer_period", "hard_iron", "water_period",
)  # fmt: skip


def _rebuild(values: dict[str, Any]) -> InsScenario:
    return InsScenario(**values)


DVL_REGIMES = (CALM, ROUGH, FISH, NO_LOCK)
FIX_REGIMES = (CALM, MULTIPATH, THERMOCLINE)
OUTAGES = ((420.0, 180.0), (780.0, 180.0), (1080.0, 120.0))


def _held(variance: float, growth: float, **more: float) -> dict[str, Any]:
    """The last velocity stands in for a silent log."""
    return {"fill": "hold", "fill_variance": variance, "fill_growth": growth, **more}


def _catalogue() -> dict[str, InsScenario]:
    # references: of outages and bursts the least error of position on training missions, of a grid of
    # imu_noise_scale (1, 3, 10; 24 missions), variance (.05 to 10) and growth (.01 to .3; 48 missions); of the
    # others the least error of velocity on 16, of variance (.03 to 1) and growth (.003 to 1); rounded
    long, bursts = _held(3.0, 0.03, imu_noise_scale=1.0), _held(0.1, 0.02, imu_noise_scale=1.0)
    short = _held(0.1, 0.003)
    members = [
        InsScenario("nominal", "the model is right: nothing beats the plain filter"),
        InsScenario("outage", "the Doppler log is silent for 180, 180 and 120 s; no fixes", outages=OUTAGES, fix_period=0.0, reference=long),
        InsScenario(
            "burst", "the Doppler log is silent half of the time, 30 s at a time on average; no fixes",
            regimes=(CALM, NO_LOCK), dwell=(10.0, 50.0), fix_period=0.0, reference=bursts,
        ),
        InsScenario("dvl-switch", "calm, rough, fish and no bottom lock follow one another", regimes=DVL_REGIMES, fix_period=5.0, reference=short),
        InsScenario("usbl-switch", "calm, multipath and thermocline follow one another", regimes=FIX_REGIMES, fix_period=5.0),
        InsScenario("anomaly", "magnetic anomalies of 8 µT, 20 to 60 s long", regimes=(CALM, ANOMALY), fix_period=5.0),
        InsScenario(
            "survey", "everything that happens to sensors, one after the other",
            regimes=(CALM, ROUGH, FISH, NO_LOCK, MULTIPATH, THERMOCLINE, ANOMALY), fix_period=5.0, reference=short,
        ),
        InsScenario("vibration", "the IMU's noise is a hundred times as large now and then", regimes=(CALM, VIBRATION), fix_period=5.0),
    ]  # fmt: skip
    return {s.name: s for s in members}


CATALOGUE: Mapping[str, InsScenario] = MappingProxyType(_catalogue())
