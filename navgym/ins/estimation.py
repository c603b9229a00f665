"""Run an INS filter over recordings."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from navgym.core.checks import Array
from navgym.core.parameters import ParameterSpace
from navgym.estimation import Estimate
from navgym.ins import filtering as kernels
from navgym.ins.batch import InsBatch
from navgym.ins.catalogue import Ins
from navgym.ins.error_state import LANE
from navgym.ins.layout import BA, BG, COLUMNS, PHI, STATES, R, V
from navgym.ins.simulation import local
from navgym.problem import Filter, Run

RULES = ("trust", "student", "correntropy", "variational", "bank", "oracle")  # the kernel's numbers
# where a filter does not expose a column
OFF = {
    "imu_noise_scale": 1.0, "dvl_noise_scale": 1.0, "fix_noise_scale": 1.0, "magnetic_noise_scale": 1.0,
    "fill": 0.0, "fill_variance": 1.0, "fill_growth": 0.0, "fill_turn_limit": 180.0, "gate": np.inf,
    "student_freedom": 4.0, "kernel_width": 50.0, "forgetting": 0.97, "vb_iterations": 3.0,
    "vibration_meter": 0.0,
}  # fmt: skip
_NAMED = (
    ("", ("north", "east", "down")), ("v", ("n", "e", "d")), ("", ("roll", "pitch", "heading")), ("bg_", "xyz"), ("ba_", "xyz"),
    ("iron_", "xyz"), ("dvl_", ("scale", "misalignment")), ("current_", ("north", "east")),
)  # fmt: skip
UNKNOWN = 5.0  # °, standard deviation of a heading that counts as not known
NO_GATE = 1e4  # a gate of this and more is off


def run(chosen: Filter, batch: InsBatch, table: Array, interval: int, everything: bool) -> Run:
    """Run one INS filter over a batch; see `navgym.problem.Problem.run`."""
    if chosen.needs_scales and any(
        r.noise_scales is None or r.imu_scale is None for r in batch.recordings
    ):
        raise ValueError(
            f"filter {chosen.name!r} needs the true noise, which only simulated recordings carry: "
            "use ins_bank."
        )
    count, steps = batch.tapes.shape
    rows = full_table(chosen.space, table)
    lanes = np.zeros(count, LANE)
    kernels.begin(lanes, batch.models, rows[:, 0])
    lanes["length"] = batch.lengths
    rest = steps if everything else 0
    states = np.full((count, steps, STATES), np.nan)
    report = np.zeros((count, max(rest, 1)), kernels.REPORT)
    for name in ("innovation", "weights", "nis", "log_likelihood"):
        report[name] = np.nan
    covariances = np.full((count, rest, STATES, STATES), np.nan)
    kernels.run(
        lanes, batch.models, batch.sensors, batch.tapes, batch.events, rule_of(chosen.option, everything),
        rows, interval, states, report, covariances,
    )  # fmt: skip
    report = report[:, :rest]
    return Run(
        states=states,
        diverged=lanes["diverged"] > 0,
        covariances=covariances,
        innovations=report["innovation"],
        nis=report["nis"],
        log_likelihood=report["log_likelihood"],
        components=report["components"],
        extras={"weights": report["weights"]},
    )


def rule_of(option: Ins, judged: bool) -> NDArray[Any]:
    """The kernel's rule (1,) of a member of the family."""
    rule = np.zeros(1, kernels.RULE)
    rule["kind"], rule["judged"] = RULES.index(option.rule), judged
    return rule


def full_table(space: ParameterSpace, table: Array) -> Array:
    """`table` (..., parameters) of a space in the kernel's columns; those not exposed are off."""
    where = columns_of(space)
    found = np.broadcast_to([OFF[c] for c in COLUMNS], (*table.shape[:-1], len(COLUMNS))).copy()
    found[..., where >= 0] = table[..., where[where >= 0]]
    gate = found[..., COLUMNS.index("gate")]
    gate[gate >= NO_GATE] = np.inf
    return np.ascontiguousarray(found)


def columns_of(space: ParameterSpace) -> NDArray[np.int64]:
    """Where each of the kernel's columns stands in a space; -1 where it is not exposed."""
    names = space.names
    return np.array([names.index(c) if c in names else -1 for c in COLUMNS])


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class InsEstimate(Estimate):
    """What an INS filter made of one recording of K filter steps.

    States (K, 22) are position (m, NED of the origin), velocity (m/s), roll, pitch, heading (rad), biases of
    gyros (rad/s) and accelerometers (m/s²), hard iron (µT), the Doppler log's scale error and misalignment
    (rad), and current (m/s). Covariances are of the error state: rows of the attitude are tilts about north,
    east and down. Innovations (K, 14) are measured less predicted: Doppler log, depth, fix, magnetometer,
    heading, water track; of several in a step the last; NaN where there was none.

    Args:
        origin: (3,) latitude and longitude (rad) and height (m) that positions count from.
    """

    origin: Array

    @property
    def health(self) -> str:
        """As of any estimate, and whether the heading is known at the end: what is dead-reckoned turns with it."""
        found = super().health
        if self.heading_deviation <= UNKNOWN:
            return found
        said = f"heading unknown: to {self.heading_deviation:.1f}° at the end"
        return said if found == "sound" else f"{found}; {said}"

    @property
    def heading_deviation(self) -> float:
        """°, standard deviation of the heading at the end."""
        return float(np.degrees(self.deviations[-1, PHI.start + 2]))

    @property
    def position(self) -> Array:
        """(K, 3) m, north, east, down of the origin."""
        return self.states[:, R]

    @property
    def velocity(self) -> Array:
        """(K, 3) m/s, north, east, down."""
        return self.states[:, V]

    @property
    def angles(self) -> Array:
        """(K, 3) roll, pitch, heading, rad."""
        return self.states[:, PHI]

    @property
    def columns(self) -> dict[str, Array]:
        """Time, places, states and their standard deviations by name, NIS and likelihood, (K,) each."""
        names = [f"{n}{axis}" for n, axes in _NAMED for axis in axes]
        places = dict(zip(("latitude", "longitude", "height"), self.places.T, strict=True))
        states = dict(zip(names, self.states.T, strict=True))
        deviations = {f"sd_{n}": d for n, d in zip(names, self.deviations.T, strict=True)}
        return (
            {"time": self.time}
            | places
            | states
            | deviations
            | {"nis": self.nis, "log_likelihood": self.log_likelihood}
        )

    @property
    def pose(self) -> tuple[Array, Array]:
        """Position (K, 3), m, north, east, down, and attitude (K, 4), body to these, scalar last."""
        good = np.isfinite(self.angles).all(axis=1)
        turned = np.full((len(self.time), 4), np.nan)
        turned[good] = Rotation.from_euler("ZYX", self.angles[good][:, ::-1]).as_quat()
        return self.position, turned

    @property
    def places(self) -> Array:
        """(K, 3) latitude and longitude, °, and height, m."""
        metres = local(np.add(self.origin, [1e-6, 1e-6, 0.0])[None], self.origin)[0, :2] / 1e-6
        angles = np.degrees(self.position[:, :2] / metres + self.origin[:2])
        return np.column_stack([angles, self.origin[2] - self.position[:, 2]])

    @property
    def gyro_bias(self) -> Array:
        """(K, 3) rad/s."""
        return self.states[:, BG]

    @property
    def accelerometer_bias(self) -> Array:
        """(K, 3) m/s²."""
        return self.states[:, BA]

    @property
    def deviations(self) -> Array:
        """(K, 22) standard deviations of the states; of the attitude about north, east, down."""
        found: Array = np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2))
        return found

    @property
    def weights(self) -> Array:
        """(K, 6) by what each kind's R was divided, last; NaN where nothing came."""
        found: Array = self.extras["weights"]
        return found


def estimate(chosen: Filter, batch: InsBatch, run: Run) -> InsEstimate:  # noqa: ARG001
    """What a filter made of a batch's only recording.

    Warns (UserWarning) where the heading is not known at the end, and where IMU samples were filled in.
    """
    recording = batch.recordings[0]
    found = InsEstimate.of(run, batch.time_of(0), origin=recording.model.origin)
    if found.heading_deviation > UNKNOWN:
        warnings.warn(
            f"the heading is known to {found.heading_deviation:.1f}° only at the end: it takes a magnetometer, position fixes "
            "on a way that turns, or better gyros.",
            stacklevel=4,
        )
    made_up = int(recording.gaps.sum())
    if made_up:
        warnings.warn(
            f"{made_up} of {len(recording)} IMU samples are missing: the last one received was held, and the "
            "filter widened its covariance there.",
            stacklevel=4,
        )
    return found
