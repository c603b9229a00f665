"""Benchmarks: ratios to well-known things, measured in turns in one run."""
