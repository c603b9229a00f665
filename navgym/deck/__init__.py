"""A ship's deck that bends between two IMUs: IDAM (Zhao et al. 2024)."""
