"""Filters of any state-space model: models, recordings, batches, kernels."""
