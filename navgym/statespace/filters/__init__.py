"""Compiled filters of state-space models, and the catalogue that names them."""
