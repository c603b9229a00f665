"""Parameters in the formats of those who use them: autopilots, robots, programs in C."""
