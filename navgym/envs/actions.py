"""Compiled steps that every environment shares: actions into parameters, squares into observations."""

from __future__ import annotations

import math

from navgym._compile import part

FLOOR = 0.05  # keeps logarithms of squares finite
LIMIT = 5.0  # observations are clipped to plus or minus this


@part
def bounded(value):
    """`value` inside plus or minus `LIMIT`; what is not a number counts as the worst."""
    return max(value, -LIMIT) if value < LIMIT else LIMIT


@part
def log_square(value):
    """Half the logarithm of a mean square, floored: 0 where it is 1."""
    return bounded(0.5 * math.log(value + FLOOR))


@part
def set_parameters(station, action, table):
    """Turn an action into physical parameters.

    Rows of `table`: column, centre and half width in the warped scale, its ends, scale code,
    whether whole numbers only, and the physical ends.
    """
    for a in range(table.shape[0]):
        u = table[a, 1] + table[a, 2] * min(max(action[a], -1.0), 1.0)
        u = min(max(u, table[a, 3]), table[a, 4])
        if table[a, 5] == 1.0:
            u = math.exp(u)
        elif table[a, 5] == 2.0:
            u = 1.0 - math.exp(-u)
        if table[a, 6] == 1.0:
            u = math.floor(u + 0.5)
        station.row[int(table[a, 0])] = min(max(u, table[a, 7]), table[a, 8])


@part
def place(station, table, a):
    """Where the parameter of action a stands in its range, -1 to 1."""
    v = station.row[int(table[a, 0])]
    if table[a, 5] == 1.0:
        v = math.log(v)
    elif table[a, 5] == 2.0:
        v = -math.log(1.0 - v)
    return 2.0 * (v - table[a, 3]) / (table[a, 4] - table[a, 3]) - 1.0
