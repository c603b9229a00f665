"""What inertial navigation needs whatever it navigates: the Earth, IMU errors, strapdown, the error-state update."""
