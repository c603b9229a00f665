"""Seeds for tuning and for reporting never meet: each split owns a range of its own."""

from __future__ import annotations

from navgym.core.checks import one_of, positive_int

SPLITS = ("train", "validation", "test")
SIZE = 10**9  # seeds per split


def seeds(split: str, count: int, start: int = 0) -> range:
    """`count` seeds of `split` ("train", "validation" or "test"), from its `start`-th on.

    Example: `navgym.seeds("test", 300)`. Ranges of different splits share no seed.
    """
    first = SPLITS.index(one_of("split", split, SPLITS)) * SIZE
    positive_int("count", count, least=0)
    positive_int("start", start, least=0)
    if start + count > SIZE:
        raise ValueError(f"start + count must not exceed {SIZE}, got {start + count}.")
    return range(first + start, first + start + count)


def split_of(seed: int) -> str:
    """The split that owns `seed`; ValueError for a seed that no split owns."""
    positive_int("seed", seed, least=0)
    if seed >= SIZE * len(SPLITS):
        raise ValueError(f"seed must lie in 0..{SIZE * len(SPLITS) - 1}, got {seed}.")
    return SPLITS[seed // SIZE]
