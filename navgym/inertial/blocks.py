"""How large a block of a sensor's rows is, and how many sensors a lane has; frozen into kernels."""

from __future__ import annotations

ROWS = 3  # of a sensor at most
SENSORS = 8  # what one lane can have; each has a memory of its own
