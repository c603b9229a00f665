"""Rotations between the frames of logs and ours: north, east, down; forward, starboard, down."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from navgym.core.checks import Array
from navgym.formats.channels import SECOND, Channel

ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # to NED, and back
FLU = np.diag([1.0, -1.0, -1.0])  # forward, left, up to forward, starboard, down, and back
UNIT = 0.01  # by how much the length of a quaternion may miss 1
GAPS = 3.0  # usual steps between two attitudes, from which nothing is known between them
SHORTEST_GAP = 0.2  # s


def rotation(quaternion: Array, enu: bool, flu: bool) -> tuple[Rotation, Array]:
    """Rotations from forward, starboard, down to north, east, down, and where there are any, (T,).

    Args:
        quaternion: (T, 4) x, y, z, w, from body to world; one that is not of length 1 is none.
        enu: whether its world is east, north, up.
        flu: whether its body is forward, left, up.
    """
    good = np.abs(np.linalg.norm(quaternion, axis=1) - 1.0) < UNIT  # False for NaN
    matrix = Rotation.from_quat(
        np.where(good[:, None], quaternion, [0.0, 0.0, 0.0, 1.0])
    ).as_matrix()
    matrix = (ENU if enu else np.eye(3)) @ matrix @ (FLU if flu else np.eye(3))
    return Rotation.from_matrix(matrix), good


def angles(quaternion: Array, enu: bool, flu: bool) -> Array:
    """Roll, pitch and heading, rad, (T, 3), NaN where there is no attitude; see `rotation`."""
    turned, good = rotation(quaternion, enu, flu)
    found = turned.as_euler("ZYX")[:, ::-1]
    return np.where(good[:, None], found, np.nan)


def attitude_at(attitude: Channel, time: NDArray[np.int64]) -> tuple[Rotation, Array]:
    """Rotations from body to world at stamps, and where they are known, (T,).

    Between two attitudes further apart than `GAPS` usual steps nothing is known. Roll and pitch that
    a compass does not tell are level.
    """
    stamps, first = np.unique(attitude.time, return_index=True)
    seconds = (stamps - stamps[0]) / SECOND
    at = np.clip((time - stamps[0]) / SECOND, 0.0, seconds[-1])
    told = attitude.values[first]
    turned = Rotation.from_euler("ZYX", np.nan_to_num(told)[:, ::-1])
    known = ~np.isnan(told[:, 2])
    inside = (time >= stamps[0]) & (time <= stamps[-1])
    if len(stamps) == 1:
        return turned[np.zeros(len(time), np.int64)], inside & known[0]
    after = np.clip(np.searchsorted(seconds, at), 1, len(seconds) - 1)
    gap = max(GAPS * float(np.median(np.diff(seconds))), SHORTEST_GAP)
    near = seconds[after] - seconds[after - 1] <= gap
    return Slerp(seconds, turned)(at), inside & near & known[after] & known[after - 1]


def world_velocity(body: Channel, attitude: Channel) -> Channel:
    """A velocity north, east, down from one in body axes; NaN where the attitude is not known."""
    turned, known = attitude_at(attitude, body.time)
    velocity, sigma = body.values[:, :3], body.values[:, 3:]
    whole = velocity.copy()
    whole[np.isnan(whole[:, 2]) & ~np.isnan(whole[:, 0]), 2] = 0.0  # a log of two axes
    C = turned.as_matrix()
    variance = np.einsum("tij,tj->ti", C**2, sigma**2)
    values = np.column_stack([turned.apply(whole), np.sqrt(variance)])
    values[np.logical_not(known)] = np.nan
    return Channel(body.name, "velocity", body.time, values, body.rank)
