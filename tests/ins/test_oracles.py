"""Rules that know the truth, and the hand rule: what they put in force."""

import dataclasses

import numpy as np
import pytest

pytest.importorskip("tqdm")

from navgym.agents.evaluation.baselines import hand_rule
from navgym.agents.evaluation.contest import Condition, Extent
from navgym.agents.evaluation.league import League
from navgym.agents.evaluation.rollout import roll_out
from navgym.ins import oracles, tracks
from navgym.ins.imu_grades import GRADES
from navgym.ins.layout import PHI, V
from navgym.problem import PROBLEMS
from navgym.simulation import simulate_many
from navgym.tuning.experiments import real_cases

INS = PROBLEMS["ins"]
OUTAGE = (80.0, 60.0)


@pytest.fixture(scope="module")
def recording():
    return simulate_many("ins/outage", [3], duration=160.0, outages=(OUTAGE,))[0]


def turned_into(recording, velocity, heading):
    """The recording with another truth: level, moving along `velocity` (K, 3) at `heading` (K,)."""
    truth = recording.truth.copy()
    truth[:, V], truth[:, PHI] = velocity, 0.0
    truth[:, PHI.start + 2] = heading
    return dataclasses.replace(recording, truth=truth)


class TestChange:
    def test_a_body_that_keeps_its_speed_in_a_turn_has_not_changed(self, recording):
        heading = np.linspace(0.0, 3.0, recording.steps)
        velocity = np.stack([np.cos(heading), np.sin(heading), np.zeros_like(heading)], axis=1)
        found = oracles.change(turned_into(recording, velocity, heading))
        np.testing.assert_allclose(found[10:], 0.0, atol=1e-12)

    def test_it_counts_from_when_the_log_last_spoke(self, recording):
        time = recording.step_time
        velocity = np.stack([0.01 * time, np.zeros_like(time), np.zeros_like(time)], axis=1)
        found = oracles.change(turned_into(recording, velocity, np.zeros_like(time)))
        heard = recording.aiding["dvl"].time[~recording.aiding["dvl"].lost]
        before = heard[heard < OUTAGE[0] + 1e-6][-1]
        k = int(np.searchsorted(time, OUTAGE[0] + 50.0))
        assert found[k] == pytest.approx(0.01 * (time[k] - before), abs=1e-9)
        assert found[: round(0.9 * OUTAGE[0] / recording.step)][20:].max() < 0.011

    def test_it_needs_the_truth(self, recording):
        blind = dataclasses.replace(recording, truth=None)
        with pytest.raises(ValueError, match="needs recordings with truth"):
            oracles.change(blind)


def test_the_gate_holds_where_the_vehicle_kept_its_velocity_and_only_there(recording):
    found, change = oracles.gate(recording), oracles.change(recording)
    np.testing.assert_array_equal(found["fill"] == 1, change < 0.1)
    silent = (recording.step_time > OUTAGE[0] + 1.0) & (recording.step_time < sum(OUTAGE))
    assert 0 < (found["fill"] == 1)[silent].sum() < silent.sum()


def test_the_variance_follows_the_square_of_what_was_lost(recording):
    found, change = oracles.variance(recording)["fill_variance"], oracles.change(recording)
    inside = (found > 0.02) & (found < 900.0)
    np.testing.assert_allclose(found[inside], 50.0 * change[inside] ** 2)


def test_a_fill_that_knows_what_it_is_worth_beats_none(recording):
    batch, errors = INS.stack([recording]), []
    for parameters in ({"imu_noise_scale": 1.0}, [oracles.variance(recording)]):
        states = INS.run("ins_kf", batch, parameters, 1).states
        errors.append(INS.scoring.errors(batch, states, ("velocity",), (0.0, 1.0))["velocity"][0])
    assert errors[1] < 0.9 * errors[0]


def test_the_hand_rule_holds_until_the_gyros_have_turned(recording):
    rolled = roll_out(hand_rule("navgym/INSDropout-v0"), [recording])
    found = rolled.schedules[0]
    time = np.arange(len(found["fill"])) * rolled.interval * recording.step
    silent = (time > OUTAGE[0] + 2.0) & (time < sum(OUTAGE))
    fill = np.asarray(found["fill"])[silent]
    assert fill[0] == 1.0
    assert (np.diff(fill) <= 0.0).all(), "once it has turned nothing stands in until the log speaks"
    heading = np.unwrap(recording.truth[:, PHI.start + 2])
    begun = round(OUTAGE[0] / recording.step)
    far = np.degrees(np.abs(heading[begun:] - heading[begun])).max()
    assert (fill[-1] == 0.0) == (far > 32.0)


class TestTracksThatFallSilent:
    def test_the_log_is_lost_once_for_as_long_as_said(self):
        made = tracks.outage(None, 2, 5, length=60.0)
        lost = made.aiding["dvl"].lost
        assert lost.sum() == pytest.approx(60, abs=1)
        assert np.abs(np.diff(lost.astype(int))).sum() == 2
        assert "fix" not in made.aiding
        assert np.flatnonzero(lost)[0] >= tracks.EARLIEST - 1.0

    def test_when_depends_on_track_and_seed(self):
        def first(track, seed):
            made = tracks.outage(None, track, seed, length=120.0)
            return int(np.flatnonzero(made.aiding["dvl"].lost)[0])

        assert first(1, 0) == first(1, 0)
        assert len({first(1, 0), first(2, 0), first(1, 1)}) == 3

    def test_policies_are_held_against_everybody_there(self, tmp_path):
        league = League("navgym/INSDropout-v0", {}, [], Extent(), folder=tmp_path)
        names = [c.name for c in league.conditions() if c.variant]
        assert names == [
            "tracks, 60 s lost", "tracks, 120 s lost", "tracks, 60 s lost, MEMS errors added",
            "tracks, 120 s lost, MEMS errors added",
        ]  # fmt: skip
        silent = real_cases(INS, None, 0.0, 2, "test", (4,), "60 s lost, MEMS errors added")
        grades = {r.model.grade for r in silent.recordings}
        assert grades == {GRADES["mems"]}
        assert silent.about["variant"] == "60 s lost, MEMS errors added"


def test_a_water_track_sails_the_same_missions_with_one_more_sensor():
    own = Condition("short", "ins/outage", {"duration": 90.0, "outages": ((70.0, 15.0),)})
    league = League("navgym/INSDropout-v0", {}, [own], Extent(runs=2), fallback=False)
    cases = league.cases(own, 0, 2)
    found = {c.entry.label: c for c in league.contenders(own, cases)}
    states, flags = found["water track"].states()
    assert not flags.any()
    alone, _ = league.run(found["predict only"], cases)
    errors = [league.errors(cases, s, ["velocity"])["velocity"] for s in (states, alone)]
    assert (errors[0] < errors[1]).all()
    seen = [r.meta["seed"] for r in cases.recordings]
    others = simulate_many("ins/outage", seen, **own.overrides, water_period=1.0)
    assert "water" in others[0].aiding
    np.testing.assert_array_equal(others[0].angle, cases.recordings[0].angle)
