"""Recordings of any lengths, side by side."""

import numpy as np
import pytest

import navgym
from navgym.statespace.batch import StateSpaceBatch

RECORDINGS = [
    navgym.simulate("auv/switch-B", seed, steps=steps)
    for seed, steps in ((0, 30), (1, 50), (2, 40))
]


def test_each_recording_keeps_its_samples_and_is_lost_beyond_its_end():
    batch = StateSpaceBatch.of(RECORDINGS)
    assert len(batch) == 3
    assert batch.lengths.tolist() == [30, 50, 40]
    for i, r in enumerate(RECORDINGS):
        n = len(r)
        np.testing.assert_array_equal(batch.y[i, :n], r.measurements)
        np.testing.assert_array_equal(batch.lost[i, :n], r.lost)
        np.testing.assert_array_equal(batch.time[i, :n], r.time)
        np.testing.assert_array_equal(batch.truth[i, :n], r.truth)
        np.testing.assert_array_equal(batch.scales[i, :n, 0], r.process_scale)
        np.testing.assert_array_equal(batch.scales[i, :n, 1], r.measurement_scale)
        assert np.isnan(batch.y[i, n:]).all()
        assert np.isnan(batch.truth[i, n:]).all()
        assert batch.lost[i, n:].all()
        assert (np.diff(batch.time[i]) > 0.0).all()


def test_some_of_a_batch_are_the_batch_of_some():
    some, wanted = (
        StateSpaceBatch.of(RECORDINGS).take([2, 1]),
        StateSpaceBatch.of([RECORDINGS[2], RECORDINGS[1]]),
    )
    for name in ("y", "lost", "time", "models", "scales", "truth", "lengths"):
        np.testing.assert_array_equal(getattr(some, name), getattr(wanted, name))


def test_the_true_noise_can_be_kept_from_a_filter():
    batch = StateSpaceBatch.of(RECORDINGS)
    blind = batch.without_scales()
    assert blind.scales is None
    assert blind.take([0]).scales is None
    np.testing.assert_array_equal(blind.y, batch.y)


def test_truth_and_scales_are_there_if_all_recordings_have_them():
    r = RECORDINGS[0]
    bare = navgym.Recording(r.time, r.measurements, model=r.model)
    mixed = StateSpaceBatch.of([r, bare])
    assert mixed.truth is None
    assert mixed.scales is None


def test_only_recordings_of_one_model_size_go_together():
    with pytest.raises(ValueError, match="at least one Recording"):
        StateSpaceBatch.of([])
    with pytest.raises(TypeError, match=r"must be a navgym\.Recording"):
        StateSpaceBatch.of([RECORDINGS[0], "auv"])
    with pytest.raises(ValueError, match="share one model size"):
        StateSpaceBatch.of([RECORDINGS[0], navgym.simulate("auv/position-only", 0, steps=9)])
