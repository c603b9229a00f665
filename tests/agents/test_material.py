"""Recordings to train on: their seeds, their conditions, their memory."""

import dataclasses

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("tyro")
pytest.importorskip("tomli_w")

from navgym.agents.training.material import material, recording
from navgym.agents.training.randomisation import drawn
from navgym.agents.training.references import HOPELESS
from navgym.agents.training.validation import Validation
from navgym.auv.conditions import AUVRanges
from navgym.core.seeds import seeds
from navgym.deck.conditions import DeckRanges
from navgym.simulation import find_scenario
from tests.agents.small import tiny


def test_training_recordings_are_of_the_training_split_and_of_the_seed_alone(tmp_path):
    env = material(tiny(tmp_path)).env
    numbers = [label["seed"] for label in env.engine.shelf.labels]
    assert numbers == list(seeds("train", 6, start=18))
    validation = Validation(tiny(tmp_path)).arenas[0].engine
    chosen = [label["seed"] for label in validation.shelf.labels]
    assert chosen == list(seeds("validation", 5))


def test_scenarios_of_a_mixture_take_turns(tmp_path):
    config = tiny(tmp_path, scenarios=("auv/switch-D", "auv/heavy"))
    names = [recording(config, i, i).meta["scenario"] for i in range(4)]
    assert names == ["auv/switch-D", "auv/heavy"] * 2
    arenas = Validation(config).arenas
    assert [arena.name for arena in arenas] == ["auv/switch-D", "auv/heavy"]


def test_too_many_recordings_are_refused_with_what_would_fit(tmp_path):
    with pytest.raises(ValueError, match=r"pool=6 recordings take .* GB.*set pool=\d, or memory="):
        material(tiny(tmp_path, memory=1e-4))


def test_lanes_do_not_end_together(tmp_path):
    env = material(tiny(tmp_path)).env
    env.reset()
    assert len(set(env.engine.stations["k"].tolist())) > 4


class TestRandomisation:
    def test_conditions_depend_on_the_seed_alone_and_cover_the_ranges(self):
        scenario, ranges = find_scenario("auv/switch-D"), AUVRanges()
        found = [drawn(scenario, ranges, seed) for seed in range(300)]
        assert found[7] == drawn(scenario, ranges, 7)
        scales = np.array([s.measurement_scale for s in found])
        assert 0.3 < (scales == 1.0).mean() < 0.7
        assert scales.min() < 0.3
        assert scales.max() > 15.0
        assert (scales >= ranges.measurement_scale[0]).all()
        assert (scales <= ranges.measurement_scale[1]).all()
        rates = [s.loss.rate for s in found]
        assert max(rates) > 0.7
        assert 0.3 < np.mean(np.array(rates) == 0.0) < 0.7

    def test_chance_nought_leaves_a_scenario_alone(self):
        scenario = find_scenario("auv/switch-B")
        assert drawn(scenario, AUVRanges(chance=0.0), 3) == scenario
        scenario = find_scenario("deck/switch-60")
        assert drawn(scenario, DeckRanges(chance=0.0), 3) == scenario

    def test_deck_conditions(self):
        scenario, ranges = find_scenario("deck/switch-60"), DeckRanges(chance=1.0, gyro_only=1.0)
        found = drawn(scenario, ranges, 1)
        glitch = next(r for r in found.regimes if r.name == "glitch")
        assert glitch.glitch_velocity == 0.0
        assert ranges.glitch_rate[0] <= glitch.glitch_rate <= ranges.glitch_rate[1]
        assert found.lever_error != scenario.lever_error
        assert found.dwell[0] <= found.dwell[1]
        assert found.believed == scenario.regimes[0]  # the flexure changes, not the belief
        assert (np.abs(found.static) >= 10.0).all()
        assert (np.abs(found.static) <= 1800.0).all()
        for before, after in zip(scenario.regimes, found.regimes, strict=True):
            factors = [np.divide(getattr(after, n), getattr(before, n)) for n in ("tau", "sigma")]
            assert np.ptp(factors, axis=1).min() > 0.0
            assert (np.abs(np.log(factors)) <= np.log(2.0) + 1e-12).all()

    def test_slams_and_glitches_come_at_once_where_drawn(self):
        scenario = find_scenario("deck/switch-60")
        for both in (0.0, 1.0):
            found = drawn(scenario, DeckRanges(chance=1.0, gyro_only=0.0, both=both), 1)
            slam, glitch = found.regimes[2:]
            wanted = glitch.glitch_rate if both else 0.0
            assert (slam.glitch_rate, found.regimes[0].glitch_rate) == (wanted, 0.0)

    def test_sizes_of_glitches_are_drawn_together_and_in_their_range(self):
        scenario, ranges = find_scenario("deck/switch-60"), DeckRanges(chance=1.0, gyro_only=0.0)
        before = next(r for r in scenario.regimes if r.name == "glitch")
        factors = []
        for seed in range(60):
            after = next(r for r in drawn(scenario, ranges, seed).regimes if r.name == "glitch")
            factors.append(after.glitch_velocity / before.glitch_velocity)
            assert after.glitch_rate_size / before.glitch_rate_size == pytest.approx(factors[-1])
        low, high = ranges.glitch_size
        assert low <= min(factors) < max(factors) <= high
        middle = np.sqrt(low * high)  # uniform in the logarithm
        assert 0.25 < np.mean(np.array(factors) < middle) < 0.75

    @pytest.mark.parametrize(
        ("kind", "fields"),
        [
            (DeckRanges, {"chance": 1.1}), (DeckRanges, {"gyro_only": -0.1}),
            (DeckRanges, {"glitch_rate": (0.1, 1.1)}), (DeckRanges, {"glitch_rate": (0.0, 0.1)}),
            (DeckRanges, {"both": 1.1}), (DeckRanges, {"mounting": (0.0, 1.0)}),
            (DeckRanges, {"flexure": (2.0, 1.0)}), (DeckRanges, {"dwell": (0.0, 1.0)}), (DeckRanges, {"slam_rate": (2.0, 1.0)}),
            (AUVRanges, {"chance": -0.1}), (AUVRanges, {"chance": 1.1}),
            (AUVRanges, {"loss": (0.0, 1.1)}), (AUVRanges, {"loss": (-0.1, 1.0)}),
            (AUVRanges, {"dwell": (0.9, 2.0)}), (AUVRanges, {"outlier_scale": (0.0, 1.0)}),
        ],
        ids=str,
    )  # fmt: skip
    def test_impossible_ranges_are_refused_by_name(self, kind, fields):
        with pytest.raises(ValueError, match=next(iter(fields))):
            kind(**fields)

    def test_the_ends_of_ranges_belong_to_them(self):
        DeckRanges(chance=0.0, gyro_only=0.0, glitch_rate=(1.0, 1.0), dwell=(1e-3, 1e-3))
        DeckRanges(chance=1.0, gyro_only=1.0)
        AUVRanges(chance=0.0, loss=(0.0, 1.0), dwell=(1.0, 1.0), outlier_scale=(1e-3, 1e-3))
        AUVRanges(chance=1.0, loss=(1.0, 1.0))

    def test_ranges_of_the_other_kind_are_refused(self):
        with pytest.raises(TypeError, match="DeckRanges are no conditions of switch-D"):
            drawn(find_scenario("auv/switch-D"), DeckRanges(), 0)

    def test_a_drawn_recording_is_the_same_in_any_pool(self, tmp_path):
        config = tiny(tmp_path, randomise=True, reward="relative")
        one, other = recording(config, 0, 5), recording(config, 3, 5)
        np.testing.assert_array_equal(one.measurements, other.measurements)

    def test_validation_has_a_set_of_drawn_conditions(self, tmp_path):
        config = tiny(tmp_path, randomise=True, reward="relative")
        arenas = Validation(config).arenas
        assert [arena.name for arena in arenas] == ["auv/switch-D", "randomised"]


def test_the_relative_reward_is_the_difference_in_units_of_the_oracle(tmp_path):
    plain = material(tiny(tmp_path, reward="difference")).env
    relative = material(tiny(tmp_path, reward="relative")).env
    for env in (plain, relative):
        env.seed(0)
        env.reset()
    action = np.full((8, 3), 0.5, dtype=np.float32)
    rewards = [env.step(action)[1] for env in (plain, relative)]
    variances = []
    for which in plain.engine.stations["which"]:
        oracle = relative.engine.shelf.tapes["oracle_variance"][which]
        variances.append(oracle.mean())
    inside = (np.abs(rewards[0]) < 20.0) & (np.abs(rewards[1]) < 20.0)
    assert inside.sum() >= 4
    ratio = (rewards[0] / np.array(variances, dtype=np.float32))[inside]
    np.testing.assert_allclose(rewards[1][inside], ratio, rtol=1e-5)


class TestReferences:
    def test_each_recording_starts_from_one_of_the_table_and_mostly_from_what_suits_it(
        self, tmp_path
    ):
        config = tiny(tmp_path, references=True, randomise=True, pool=40, reward="relative")
        engine = material(config).env.engine
        rows = np.unique(engine.shelf.stations["row"], axis=0)
        assert len(rows) > 5
        plain = material(dataclasses.replace(config, references=False)).env.engine
        own, other = (e.shelf.tapes["reference_error"].mean(axis=1) for e in (engine, plain))
        assert (
            own <= HOPELESS**2 * other * (1 + 1e-9)
        ).all()  # of the best, so of the usual one too
        assert (own < other).mean() > 0.2

    def test_it_depends_on_the_seed_alone(self, tmp_path):
        config = tiny(tmp_path, references=True)
        one, other = (material(config).env.engine.shelf.stations["row"] for _ in range(2))
        np.testing.assert_array_equal(one, other)

    def test_a_share_of_recordings_is_left_as_the_scenario_is(self, tmp_path):
        config = tiny(tmp_path, randomise=True, untouched=0.3, ranges={"chance": 1.0})
        wholes = [recording(config, i, i).meta["regimes"] for i in range(100)]
        usual = find_scenario("auv/switch-D")
        assert sum(w == [r.name for r in usual.regimes] for w in wholes) == 30
