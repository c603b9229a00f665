"""INS/DVL: an AUV's own navigator, an error-state filter of IMU, Doppler log, depth, magnetometer and fixes."""
