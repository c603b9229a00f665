"""Lanes, steps and sensors for tests: small kernels around the filter's parts."""

import numpy as np
from scipy.spatial.transform import Rotation

from navgym.core.compile import kernel
from navgym.inertial.block_update import project_block
from navgym.inertial.earth import radii_of_curvature
from navgym.ins.batch import InsBatch
from navgym.ins.error_state import LANE, navigate, take_over
from navgym.ins.estimation import full_table, rule_of
from navgym.ins.filtering import begin
from navgym.ins.layout import AT, STATES
from navgym.ins.measurements import linearise, radii
from navgym.ins.scenarios import CATALOGUE as SCENARIOS
from navgym.ins.simulation import simulate


@kernel
def reckon(lanes, models, tapes, transitions):
    """Move a lane's nominal over its tape; fills each step's Φ (K, 9, 15)."""
    for k in range(len(tapes)):
        navigate(lanes[0], models[0], tapes[k])
        for i in range(9):
            for j in range(15):
                transitions[k, i, j] = lanes[0].Phi[i, j]


@kernel
def correct(lanes, dx):
    """Let the nominal take an error over."""
    lane = lanes[0]
    meridian, across = radii(lane)
    for i in range(len(dx)):
        lane.dx[i] = dx[i]
    take_over(lane, meridian, across)


@kernel
def look(lanes, models, sensors, events, H):
    """Linearise an event: fills H (3, n) and leaves r in the lane."""
    lane = lanes[0]
    linearise(lane, models[0], events[0], sensors[events[0].sensor])
    project_block(lane)
    for c in range(lane.rows):
        for t in range(lane.touched):
            H[c, lane.index[t]] += lane.H[c, t]


def scenario(**overrides):
    """Every sensor on board, as short as wanted."""
    return SCENARIOS["nominal"].override(**({"water_period": 1.0, "dvl_lever": (1.2, -0.4, 0.3)} | overrides))  # fmt: skip


def made(seed=0, **overrides):
    """A recording."""
    return simulate(scenario(**overrides), [seed])[0]


def lane_at_truth(recording, batch, k):
    """A lane (1,) whose nominal is the truth at the end of step k, and small random errors of constants."""
    lane, truth = np.zeros(1, LANE), recording.truth[k]
    begin(lane, batch.models, np.zeros((1, lane["row"].shape[1])))
    model = batch.models[0]
    lane["place"][0, :2] = model["origin"][:2] + truth[:2] / model["metres"]
    lane["place"][0, 2] = model["origin"][2] - truth[2]
    lane["v"][0] = truth[AT.V : AT.V + 3]
    lane["attitude"][0] = Rotation.from_euler("ZYX", truth[8:5:-1]).as_matrix()
    lane["bg"][0], lane["ba"][0] = truth[AT.BG : AT.BG + 3], truth[AT.BA : AT.BA + 3]
    lane["M"][0], lane["s"], lane["alpha"] = truth[AT.M : AT.M + 3], truth[AT.S], truth[AT.ALPHA]
    lane["c"][0] = truth[AT.C :]
    return lane


def errors_of(batch, states):
    """Errors (N, K, n) as the error state counts them: attitude as φ, constants as true − nominal."""
    found = states - batch.truth
    shape = states.shape[:2]
    true, own = (
        Rotation.from_euler("ZYX", x[..., 8:5:-1].reshape(-1, 3)) for x in (batch.truth, states)
    )
    found[..., 6:9] = -(own * true.inv()).as_rotvec().reshape(*shape, 3)
    found[..., 9:] *= -1.0
    return found


def metres_at(lane):
    """Metres per radian of latitude and of longitude at a lane's place."""
    latitude, _, height = lane["place"][0]
    meridian, across = radii_of_curvature(latitude)
    return np.array([meridian + height, (across + height) * np.cos(latitude)])


__all__ = ["STATES", "InsBatch", "full_table", "rule_of"]
