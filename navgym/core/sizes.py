"""Sizes of a record's arrays inside kernels: constants where they are small, numbers where not.

A loop whose length the compiler knows is unrolled, which is fast for four states and ruins compile
time for fifteen (minutes per filter, and no faster code). So kernels ask here: up to `UNROLLED` a
size is a constant of the record's type, above it a field of the record, through which the compiler
cannot look. What stands here is frozen into kernels.
"""

from __future__ import annotations

from typing import Any

from numba.extending import overload

UNROLLED = 5
_OPTIONS: Any = {"error_model": "numpy", "nogil": True, "forceinline": True}


def _short(record: Any, array: str) -> bool:
    """Whether loops over an array of a record's (numba) type are to be unrolled."""
    return bool(record.fields[array].type.shape[0] <= UNROLLED)


def state_size(lane: Any) -> int:
    """Number of states of a lane."""
    return int(lane.x.shape[0])


@overload(state_size, jit_options=_OPTIONS)
def _states(lane):
    if _short(lane, "x"):
        return lambda lane: lane.x.shape[0]
    return lambda lane: lane.n


def sample_size(lane: Any) -> int:
    """Number of measurement components of a lane."""
    return int(lane.y.shape[0])


@overload(sample_size, jit_options=_OPTIONS)
def _measured(lane):
    if _short(lane, "y"):
        return lambda lane: lane.y.shape[0]
    return lambda lane: lane.m


def model_size(model: Any) -> int:
    """Number of states of a model or a motion."""
    return int(model.F.shape[0])


@overload(model_size, jit_options=_OPTIONS)
def _columns(model):
    if _short(model, "F"):
        return lambda model: model.F.shape[0]
    return lambda model: model.n


def model_rows(model: Any) -> int:
    """Number of measurement components of a model."""
    return int(model.rows.shape[0])


@overload(model_rows, jit_options=_OPTIONS)
def _rows(model):
    if _short(model, "rows"):
        return lambda model: model.rows.shape[0]
    return lambda model: model.m
