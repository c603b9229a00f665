"""Filters: compiled kernels, and the catalogue that names them."""
