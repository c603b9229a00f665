"""An AUV that loses measurements: QIVBF (Yang et al. 2020) and what it is compared with."""
