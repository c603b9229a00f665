"""`navgym.smooth` on INS recordings: nothing later, nothing changed; errors smaller, and as large as told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import navgym
from navgym.ins.catalogue import CATALOGUE
from navgym.ins.layout import PHI, STATES, R, V
from navgym.ins.recording import Aiding

AS_MODELLED = {"imu_noise_scale": 1.0}


def silent_after(recording, time):
    """The recording without any measurement after a time."""
    cut = {
        name: Aiding(a.time, a.values, a.lost | (a.time > time))
        for name, a in recording.aiding.items()
    }
    return replace(recording, aiding=cut)


def horizontal(estimate, recording, block):
    """RMS of a horizontal error from a minute on."""
    off = (estimate.states - recording.truth)[300:, block.start : block.start + 2]
    return np.sqrt((off**2).sum(axis=1).mean())


@pytest.fixture(scope="module")
def missions():
    """Three missions with fixes, of ten minutes."""
    return [navgym.simulate("ins/nominal", s, duration=600.0) for s in navgym.seeds("train", 3)]


def test_where_nothing_comes_later_nothing_changes(missions):
    recording = silent_after(missions[0], 300.0)
    found, filtered = navgym.smooth("ins_kf", recording), navgym.estimate("ins_kf", recording)
    late = found.time > 301.0
    sd = filtered.deviations + 1e-30
    assert (np.abs(found.states - filtered.states) / sd)[late].max() < 1e-6
    off = found.covariances - filtered.covariances
    assert (np.abs(off) / (sd[:, :, None] * sd[:, None, :]))[late].max() < 1e-6
    assert (np.abs(found.states - filtered.states) / sd)[~late][:, R].max() > 0.3


def test_errors_are_smaller_and_as_large_as_told(missions):
    shares, told = [], []
    for recording in missions:
        after, before = (
            f("ins_kf", recording, AS_MODELLED) for f in (navgym.smooth, navgym.estimate)
        )
        shares.append(
            [horizontal(after, recording, b) / horizontal(before, recording, b) for b in (R, V)]
        )
        off = after.states - recording.truth
        for block in (R, V):
            own = slice(block.start, block.start + 2)
            x, P = off[:, own], after.covariances[:, own, own]
            told.append(
                (x * np.linalg.solve(P, x[..., None])[..., 0])[300:].sum(axis=1).mean() / 2.0
            )
        heading = off[:, PHI.stop - 1]
        assert np.abs((heading + np.pi) % (2.0 * np.pi) - np.pi)[10:].max() < np.radians(1.0)
    position, velocity = np.mean(shares, axis=0)
    assert position < 0.75
    assert velocity < 0.75
    assert np.mean(told[::2]) == pytest.approx(
        1.0, abs=0.5
    )  # positions: few of them are independent
    assert np.mean(told[1::2]) == pytest.approx(0.95, abs=0.2)


def test_a_fix_after_an_outage_puts_the_way_there_right():
    """By the last fix, seconds after the Doppler log's two minutes of silence, the drift is taken back."""
    recording = navgym.simulate("ins/nominal", 9, duration=600.0)
    dvl = recording.aiding["dvl"]
    mute = dvl.lost | ((dvl.time > 300.0) & (dvl.time < 420.0))
    fix = recording.aiding["fix"]
    unheard = fix.lost | ((fix.time > 290.0) & (fix.time < 420.0))
    aiding = {**recording.aiding, "dvl": Aiding(dvl.time, dvl.values, mute), "fix": Aiding(fix.time, fix.values, unheard)}  # fmt: skip
    dark = replace(recording, aiding=aiding)
    after, before = (
        f("ins_kf", dark, {**AS_MODELLED, "fill": "skip"}) for f in (navgym.smooth, navgym.estimate)
    )
    within = (after.time > 300.0) & (after.time < 420.0)
    drift, left = (
        np.linalg.norm((e.states - dark.truth)[within][:, :2], axis=1).max()
        for e in (before, after)
    )
    assert left < 0.5 * drift


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_filter_can_be_smoothed(name):
    recording = navgym.simulate("ins/survey", 3, duration=60.0)
    found, filtered = navgym.smooth(name, recording), navgym.estimate(name, recording)
    np.testing.assert_allclose(found.states[-1], filtered.states[-1], rtol=1e-12)
    variance = np.diagonal(found.covariances, axis1=1, axis2=2)
    assert found.states.shape == (len(found.time), STATES)
    assert (variance >= 0.0).all()
    assert (
        variance[:, :9] <= 1.0001 * np.diagonal(filtered.covariances, axis1=1, axis2=2)[:, :9]
    ).all()
