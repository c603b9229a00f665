"""Filters that tune themselves on live data."""
