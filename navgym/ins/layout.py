"""States and parameter columns of the INS filters, by name; what comes out of here is frozen into kernels."""

from __future__ import annotations

from navgym.inertial.states import Layout, State

LAYOUT = Layout(
    State("R", "δr", "m", "position: north, east, down"),
    State("V", "δv", "m/s", "velocity: north, east, down"),
    State("PHI", "φ", "rad", "attitude about north, east, down; answered as roll, pitch, heading"),
    State("BG", "b_g", "rad/s", "bias of the gyros"),
    State("BA", "b_a", "m/s²", "bias of the accelerometers"),
    State("M", "M", "µT", "hard iron at the magnetometer, body axes"),
    State("S", "s", "1", "scale error of the Doppler log", 1),
    State("ALPHA", "α", "rad", "misalignment of the Doppler log about its vertical", 1),
    State("C", "c", "m/s", "current: north, east", 2),
)
STATES = LAYOUT.size
AT = LAYOUT.first
R, V, PHI, BG, BA, M, S, ALPHA, C = LAYOUT.slices
MOVING, TOUCHING = 9, 15  # δr, δv, φ move; they and the IMU's biases move them
TOUCHED = 11  # states that one sensor touches at most

COLUMNS = (  # of a lane's parameter row
    "imu_noise_scale", "dvl_noise_scale", "fix_noise_scale", "magnetic_noise_scale", "fill", "fill_variance",
    "fill_growth", "fill_turn_limit", "gate", "student_freedom", "kernel_width", "forgetting", "vb_iterations",
    "vibration_meter",
)  # fmt: skip
(
    IMU, DVL, FIX, MAGNETIC, FILL, FILL_VARIANCE, FILL_GROWTH, FILL_TURN, GATE, FREEDOM, WIDTH, FORGET, ITERATIONS,
    METER,
) = range(len(COLUMNS))  # fmt: skip
