"""Portable policies: two small files that numpy runs."""
