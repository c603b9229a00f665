"""Agents that tune filters while they run: the next room to be built."""
