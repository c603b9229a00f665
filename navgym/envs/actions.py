"""Compiled steps that every environment shares: actions into parameters, squares into observations."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from navgym.core.checks import Array
from navgym.core.compile import kernel, part
from navgym.core.parameters import ParameterSpace

FLOOR = 0.05  # keeps logarithms of squares finite
LIMIT = 5.0  # observations are clipped to plus or minus this


def action_table(space: ParameterSpace, names: Iterable[str], row: Array, residual: bool) -> Array:
    """How actions -1 to 1 become the parameters `names` of `space`, (k, 9): what kernels read.

    Rows: column in the space, centre and half width in the warped scale, its ends, scale code,
    whether whole numbers only, and the physical ends.

    Args:
        space: a filter's whole space.
        names: what the actions set, in order.
        row: (P,) physical parameters in force otherwise.
        residual: whether an action of 0 leaves the parameter as it is in `row`; else it is the
            middle of the range.
    """
    rows = []
    chosen = space.subset(names)
    for p, (low, high, code, integer) in zip(chosen, chosen.table(), strict=True):
        column = space.index(p.name)
        centre = p.warp(row[column]) if residual else (low + high) / 2
        rows.append((column, centre, (high - low) / 2, low, high, code, integer, p.low, p.high))
    return np.array(rows, dtype=np.float64)


def restlessness(before: Array, after: Array, table: Array) -> Array:
    """How far parameters moved, (N,): mean |Δ| on their own scales, mostly logarithms.

    Args:
        before: (N, P) physical parameters.
        after: (N, P).
        table: of the parameters that count; see `action_table`.
    """
    moved = [
        np.abs(_warped(after[:, int(row[0])], row[5]) - _warped(before[:, int(row[0])], row[5]))
        for row in table
    ]
    found: Array = np.mean(moved, axis=0)
    return found


def _warped(values: Array, code: float) -> Array:
    found: Array = values
    if code == 1.0:
        found = np.log(values)
    elif code == 2.0:
        found = -np.log(1.0 - values)
    return found


@part
def bounded(value):
    """`value` inside plus or minus `LIMIT`; what is not a number counts as the worst."""
    return max(value, -LIMIT) if value < LIMIT else LIMIT


@part
def log_square(value):
    """Half the logarithm of a mean square, floored: 0 where it is 1."""
    return bounded(0.5 * math.log(value + FLOOR))


@part
def physical(action, table, a):
    """The physical value of parameter a of `table` (see `action_table`) under its action, -1 to 1."""
    u = table[a, 1] + table[a, 2] * min(max(action, -1.0), 1.0)
    u = min(max(u, table[a, 3]), table[a, 4])
    if table[a, 5] == 1.0:
        u = math.exp(u)
    elif table[a, 5] == 2.0:
        u = 1.0 - math.exp(-u)
    if table[a, 6] == 1.0:
        u = math.floor(u + 0.5)
    return min(max(u, table[a, 7]), table[a, 8])


@part
def set_parameters(station, action, table):
    """Turn an action into the physical parameters of a station."""
    for a in range(table.shape[0]):
        station.row[int(table[a, 0])] = physical(action[a], table, a)


@kernel
def fill_rows(rows, actions, table):
    """Turn actions (N, k) into physical parameters, in their columns of `rows` (N, P).

    Returns False, having done nothing, if an action is not a number.
    """
    for i in range(actions.shape[0]):
        for a in range(table.shape[0]):
            if not math.isfinite(actions[i, a]):
                return False
    for i in range(actions.shape[0]):
        for a in range(table.shape[0]):
            rows[i, int(table[a, 0])] = physical(actions[i, a], table, a)
    return True


@part
def place(station, table, a):
    """Where the parameter of action a stands in its range, -1 to 1."""
    v = station.row[int(table[a, 0])]
    if table[a, 5] == 1.0:
        v = math.log(v)
    elif table[a, 5] == 2.0:
        v = -math.log(1.0 - v)
    return 2.0 * (v - table[a, 3]) / (table[a, 4] - table[a, 3]) - 1.0


@part
def foretold(nis, log_det, count):
    """How well a filter has foretold `count` components: their log-density, but for a constant,
    as if they had heavy tails.

    A Student-t law with one degree of freedom under the filter's S. Under a Gaussian one, a
    filter that is right to leave outliers out is punished for each of them.
    """
    return -0.5 * ((1.0 + count) * math.log1p(nis) + log_det)
