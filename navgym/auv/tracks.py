"""The real tracks that AUV filters are reported on: A-KIT, or a simulated stand-in."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from navgym.auv.akit import read_akit
from navgym.simulation import simulate_many
from navgym.statespace.models import LinearModel
from navgym.statespace.recording import Recording

STAND_IN_STEPS = 400


def recording(folder: Path | None, track: int, rate: float, seed: int) -> Recording:
    """A track under independent losses.

    Args:
        folder: of the A-KIT data; None makes the simulated stand-in.
        track: its number.
        rate: share of lost samples.
        seed: of noise and losses.
    """
    if folder is None:
        return stand_in(track, rate, seed)
    return read_akit(folder, track=track, loss=rate, seed=seed)


def stand_in(track: int, rate: float, seed: int) -> Recording:
    """A simulated track for machines without real ones: unmodelled turns, A-KIT's noise model.

    The way sailed belongs to `track`, noise and losses to `seed`, as with the real tracks.
    """
    (way,) = simulate_many("auv/turn", [track], STAND_IN_STEPS)
    model = LinearModel.white_acceleration(way.time[1] - way.time[0], x0=way.truth[0])
    noise, losses = (
        np.random.default_rng(words) for words in np.random.SeedSequence([track, seed]).spawn(2)
    )
    truth = way.truth[1:]
    v = noise.standard_normal(truth.shape) * np.sqrt(np.diag(model.R))
    return Recording(
        time=way.time[1:],
        measurements=truth + v,
        lost=losses.random(len(truth)) < rate,
        truth=truth,
        model=model,
        meta={"track": track, "seed": int(seed), "source": "simulated stand-in"},
    )
