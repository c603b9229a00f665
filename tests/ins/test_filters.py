"""The INS filters against a dense twin, pyins, and the laws that a right model obeys."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from navgym.inertial.mechanization import mechanise
from navgym.ins.batch import InsBatch
from navgym.ins.catalogue import CATALOGUE
from navgym.ins.estimation import run
from navgym.ins.layout import LAYOUT
from navgym.ins.model import AidingModel
from navgym.ins.recording import Aiding, InertialRecording
from navgym.ins.simulation import simulate
from tests.ins.lanes import errors_of, made, scenario
from tests.twins import ins as twin

MATCHED = {"imu_noise_scale": 1.0}


def estimated(name, batch, everything=True, **parameters):
    """A run of one filter with one set of parameters; the IMU's noise as it is."""
    chosen = CATALOGUE[name]
    table = chosen.space.array(MATCHED | parameters)[None]
    return run(chosen, batch, table, 5, everything)


def test_the_kalman_filter_is_its_dense_twin():
    recording = made(seed=1, duration=60.0, dvl_lever=(1.2, -0.4, 0.3), fix_period=5.0)
    batch = InsBatch.of([recording])
    found = estimated("ins_kf", batch)
    states, covariances, nis = twin.run(batch)
    sd = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    off = found.states[0] - states
    assert (np.abs(off) / sd).max() < 2e-3
    P = found.covariances[0]
    assert (np.abs(P - covariances) / (sd[:, :, None] * sd[:, None, :])).max() < 2e-3
    np.testing.assert_array_equal(np.isnan(found.nis[0]), np.isnan(nis))
    np.testing.assert_allclose(found.nis[0], nis, rtol=2e-2, atol=1e-3)


def test_every_rule_is_the_kalman_filter_where_it_is_off():
    batch = InsBatch.of([made(seed=1, duration=20.0)])
    plain = estimated("ins_kf", batch).states
    # a kernel of 50 weighs r = S-like residuals by exp(−NIS/5000)
    np.testing.assert_allclose(
        estimated("ins_mcc", batch, kernel_width=50.0).states, plain, atol=1e-3
    )
    np.testing.assert_allclose(estimated("oracle", batch).states, plain, atol=1e-12)


def test_closed_on_a_tape_is_closed_at_the_imus_rate():
    # E3: 1-4 mm against a filter that restarts at every IMU sample
    recording = made(seed=3, duration=60.0)
    fine = InertialRecording(
        recording.time, recording.angle, recording.velocity, recording.aiding,
        recording.model.replace(samples_per_step=1),
    )  # fmt: skip
    coarse = estimated("ins_kf", InsBatch.of([recording])).states[0]
    close = estimated("ins_kf", InsBatch.of([fine])).states[0][19::20]
    assert np.abs(coarse[:, :3] - close[:, :3]).max() < 4e-3
    assert np.abs(coarse[:, 6:9] - close[:, 6:9]).max() < 2e-5


def test_dead_reckoning_on_the_tape_is_that_of_every_increment():
    recording = made(seed=5, duration=60.0, grade="navigation")
    silent = InertialRecording(
        recording.time, recording.angle, recording.velocity, {}, recording.model
    )
    batch = InsBatch.of([silent])
    found = estimated("ins_kf", batch)
    count = len(recording)
    place, v, C = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3, 3))
    start = batch.models["start"][0]
    mechanise(
        np.array(recording.angle), np.array(recording.velocity), recording.interval, start[:3].copy(),
        start[3:6].copy(), start[6:].reshape(3, 3).copy(), place, v, C,
    )  # fmt: skip
    model = batch.models[0]
    north, east = ((place[-1, :2] - model["origin"][:2]) * model["metres"]).T
    assert found.states[0, -1, :2] == pytest.approx([north, east], abs=5e-3)
    assert found.states[0, -1, 3:6] == pytest.approx(v[-1], abs=1e-4)
    assert not found.components.any()
    assert np.isnan(found.nis).all()


def test_it_is_pyins_feedback_filter_on_the_same_increments():
    pandas = pytest.importorskip("pandas")
    filters, sensor, seen = (pytest.importorskip(f"pyins.{m}") for m in ("filters", "inertial_sensor", "measurements"))  # fmt: skip
    # a heading that is known: else the first update, linearised in other coordinates there, differs by φ²
    full = made(
        seed=6, duration=40.0, fix_period=5.0, calibrated=True, dvl_lever=(0.0, 0.0, 0.0), heading_deviation=0.2
    )  # fmt: skip
    model = full.model.replace(
        sensors={"dvl": AidingModel("dvl", 0.01), "fix": AidingModel("fix", 2.0)}, hard_iron=0.0
    )
    aiding = {n: full.aiding[n] for n in ("dvl", "fix")}
    recording = InertialRecording(full.time, full.angle, full.velocity, aiding, model)
    found = estimated("ins_kf", InsBatch.of([recording]))
    _, arw, _, vrw, drift, sway = model.imu.si
    bias_g, bias_a = model.imu.si[0], model.imu.si[2]
    time = full.time
    turned = full.velocity + 0.5 * np.cross(full.angle, full.velocity)
    increments = pandas.DataFrame(
        np.column_stack([np.full(len(time), full.interval), full.angle, turned]), index=time,
        columns=["dt", "theta_x", "theta_y", "theta_z", "dv_x", "dv_y", "dv_z"],
    )  # fmt: skip
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    degrees = np.degrees([model.latitude, model.longitude])
    start = pandas.Series([*degrees, model.height, *model.velocity, *np.degrees(model.attitude)], index=names, name=0.0)  # fmt: skip
    packed = InsBatch.of([recording]).models[0]
    fixes = np.column_stack(
        [
            *np.degrees(aiding["fix"].values[:, :2] / packed["metres"] + packed["origin"][:2]).T,
            packed["origin"][2] - aiding["fix"].values[:, 2],
        ]
    )
    measurements = [
        seen.BodyVelocity(pandas.DataFrame(aiding["dvl"].values, index=aiding["dvl"].time, columns=["VX", "VY", "VZ"]), 0.01),
        seen.Position(pandas.DataFrame(fixes, index=aiding["fix"].time, columns=["lat", "lon", "alt"]), 2.0),
    ]  # fmt: skip
    tilt, heading = np.degrees([model.tilt_deviation, model.heading_deviation])
    other = filters.run_feedback_filter(
        start, model.position_deviation, model.velocity_deviation, tilt, heading, increments,
        sensor.EstimationModel(bias_g, arw, drift), sensor.EstimationModel(bias_a, vrw, sway),
        measurements, time_step=0.2,
    )  # fmt: skip
    k = round(38.6 / 0.2) - 1  # between two measurements of both
    moment = recording.step_time[k]
    row = other.trajectory.iloc[np.argmin(np.abs(other.trajectory.index - moment))]
    position = (np.radians(row[["lat", "lon"]].to_numpy(float)) - packed["origin"][:2]) * packed[
        "metres"
    ]
    assert np.abs(found.states[0, k, :2] - position).max() < 1e-3
    assert np.abs(found.states[0, k, 3:6] - row[["VN", "VE", "VD"]].to_numpy(float)).max() < 1e-4
    sd = other.trajectory_sd.iloc[np.argmin(np.abs(other.trajectory_sd.index - moment))]
    own = np.sqrt(np.diag(found.covariances[0, k]))
    assert own[:2] == pytest.approx(sd[["north", "east"]].to_numpy(float), rel=1e-4)
    assert np.degrees(own[8]) == pytest.approx(sd["heading"], rel=1e-4)


class TestConsistency:
    """E4: a matched filter's errors are as large as it says."""

    @pytest.fixture(scope="class")
    @classmethod
    def runs(cls):
        batch = InsBatch.of(simulate(scenario(duration=600.0, dvl_lever=(0.0, 0.0, 0.0)), range(2_000_000_000, 2_000_000_012)))  # fmt: skip
        return batch, estimated("ins_kf", batch)

    @staticmethod
    def nees(batch, found, indices, k):
        e, P = errors_of(batch, found.states)[:, k][..., indices], found.covariances[:, k]
        P = P[..., indices, :][..., indices]
        each = np.einsum("nki,nki->nk", e, np.linalg.solve(P, e[..., None])[..., 0])
        return each.mean() / len(indices)

    def test_nees_is_one_per_degree_of_freedom(self, runs):
        batch, found = runs
        k = np.arange(300, batch.steps, 100)
        for name in ("R", "V", "PHI", "BG", "BA", "M", "C"):
            nees = self.nees(batch, found, list(LAYOUT.indices(name)), k)
            assert 0.6 < nees < 1.5, (name, nees)

    def test_nis_is_one_per_degree_of_freedom(self, runs):
        _, found = runs
        assert np.nansum(found.nis) / found.components.sum() == pytest.approx(1.0, abs=0.02)

    def test_an_uncalibrated_log_that_is_believed_makes_the_filter_overconfident(self, runs):
        batch, matched = runs
        sure = [r.model.replace(dvl_scale=0.0, dvl_misalignment=0.0) for r in batch.recordings]
        blind = InsBatch.of(
            [InertialRecording(r.time, r.angle, r.velocity, r.aiding, m, truth=r.truth) for r, m in zip(batch.recordings, sure, strict=True)]
        )  # fmt: skip
        found, k = estimated("ins_kf", blind), np.arange(300, batch.steps, 100)
        velocity = list(LAYOUT.indices("V"))
        assert self.nees(blind, found, velocity, k) > 1.15 * self.nees(batch, matched, velocity, k)


class TestHeadingThatNothingShows:
    """An unknown velocity and heading at the start: a Doppler log must not tell what it cannot see."""

    @staticmethod
    def ended(grade, fix_period):
        """Errors and deviations of the heading after a minute, °."""
        batch = InsBatch.of(
            simulate(
                scenario(
                    duration=60.0, grade=grade, fix_period=fix_period, magnetometer_period=0.0, water_period=0.0,
                    heading_deviation=8.0, velocity_deviation=1.0,
                ),
                range(2_000_000_000, 2_000_000_016),
            )
        )  # fmt: skip
        found, at = estimated("ins_kf", batch), LAYOUT.indices("PHI")[2]
        e, P = errors_of(batch, found.states)[:, -1, at], found.covariances[:, -1, at, at]
        return np.degrees(e), np.degrees(np.sqrt(P))

    def test_it_stays_unknown_to_gyros_that_cannot_feel_the_earth_turn(self):
        e, sd = self.ended("mems", 0.0)
        assert sd.min() > 0.8 * 8.0
        assert (
            np.mean((e / sd) ** 2) < 2.5
        )  # 81 where P is left about the velocity before an update

    @pytest.mark.parametrize(("grade", "fix_period"), [("mems", 5.0), ("navigation", 0.0)])
    def test_where_something_shows_it_the_error_is_as_large_as_said(self, grade, fix_period):
        e, sd = self.ended(grade, fix_period)
        assert sd.max() < 3.0
        assert np.mean((e / sd) ** 2) < 2.5  # 45 and 225


class TestObservability:
    """E4: what 10 min of a mission tell of each state."""

    @pytest.mark.parametrize(
        ("overrides", "heading"),
        [({}, 0.15), ({"magnetometer_period": 0.0}, 0.6), ({"magnetometer_period": 0.0, "fix_period": 0.0}, 1.0)],
    )  # fmt: skip
    def test_heading_needs_a_magnetometer_or_fixes(self, overrides, heading):
        batch = InsBatch.of([made(seed=1, duration=600.0, grade="tactical", **overrides)])
        P = np.diagonal(estimated("ins_kf", batch).covariances[0], axis1=1, axis2=2)
        assert np.sqrt(P[-1, 8] / P[0, 8]) < heading
        if not overrides.get("fix_period", 1.0):
            assert P[-1, 0] > 2.0 * P[10, 0]
            assert np.sqrt(P[-1, 8] / P[0, 8]) > 0.2


class TestLostLog:
    def outage(self, **parameters):
        recording = made(seed=1, duration=300.0, fix_period=0.0, outages=((60.0, 300.0),), water_period=0.0, legs=(500.0, 500.0))  # fmt: skip
        batch = InsBatch.of([recording])
        return batch, estimated("ins_kf", batch, **parameters)

    def test_skipping_ignores_every_fill_parameter(self):
        one, other = (self.outage(fill="skip", fill_variance=x)[1] for x in (0.1, 1.0))
        np.testing.assert_array_equal(one.states, other.states)

    def test_a_held_velocity_keeps_the_variance_bounded(self):
        _, skip = self.outage()
        _, hold = self.outage(fill="hold", fill_variance=0.1, fill_growth=0.001)
        assert hold.covariances[0, -1, 3, 3] < 0.2 * skip.covariances[0, -1, 3, 3]
        assert np.isnan(hold.innovations[0, 300:, :3]).all()  # what stands in is no innovation

    def test_holding_ends_once_the_gyros_have_turned(self):
        batch, free = self.outage(fill="hold")
        _, bound = self.outage(fill="hold", fill_turn_limit=5.0)
        _, skip = self.outage()
        # while it goes straight both hold; a vehicle that rolls in waves by less keeps holding
        C = Rotation.from_euler("ZYX", batch.truth[0, :, 8:5:-1])
        turned = np.degrees((C[299].inv() * C[300:]).magnitude())
        first = int(np.argmax(turned > 5.0)) if (turned > 5.0).any() else len(turned)
        np.testing.assert_array_equal(
            free.states[0, : 300 + first - 2], bound.states[0, : 300 + first - 2]
        )
        if first < len(turned) - 10:
            assert bound.covariances[0, -1, 3, 3] > free.covariances[0, -1, 3, 3]
            assert bound.covariances[0, -1, 3, 3] < skip.covariances[0, -1, 3, 3]

    def test_extrapolation_is_a_parabola_through_the_last_three(self):
        # a log whose velocities lie on a parabola, and no noise to speak of: the fill continues it
        recording = made(seed=1, duration=20.0, fix_period=0.0, water_period=0.0)
        dvl = recording.aiding["dvl"]
        lost = dvl.time > 12.5
        lost[lost] = np.arange(lost.sum()) == 0
        aiding = dict(recording.aiding) | {"dvl": Aiding(dvl.time, dvl.values, lost)}
        own = InertialRecording(
            recording.time, recording.angle, recording.velocity, aiding, recording.model
        )
        given = 3.0 * dvl.values[11] - 3.0 * dvl.values[10] + dvl.values[9]
        values = dvl.values.copy()
        values[12] = given
        noise = np.sqrt(19.0 * 0.01)  # Σl² of (3, −3, 1), times the variance
        told = dict(aiding) | {"dvl": Aiding(dvl.time, np.where(np.arange(20)[:, None] == 12, np.nan, dvl.values))}  # fmt: skip
        sensors = dict(recording.model.sensors) | {"fill": AidingModel("dvl", noise, recording.model.sensors["dvl"].lever_arm)}  # fmt: skip
        told["fill"] = Aiding([13.0], [given])
        twin_of = InertialRecording(
            recording.time, recording.angle, recording.velocity, told, recording.model.replace(sensors=sensors)
        )  # fmt: skip
        fill = {"fill": "extrapolate", "fill_variance": 0.01, "fill_growth": 0.001}
        one = estimated("ins_kf", InsBatch.of([own]), **fill).states[0, 64]
        other = estimated("ins_kf", InsBatch.of([twin_of])).states[0, 64]
        growth = 0.001 * 1.0 / 0.01  # the variance has grown for a second
        assert one[:9] == pytest.approx(other[:9], abs=growth * 1e-2)


class TestRobustness:
    @pytest.mark.parametrize("name", ["ins_student", "ins_mcc", "ins_vb", "ins_bank"])
    def test_a_wild_ping_moves_a_robust_filter_little(self, name):
        recording = made(seed=2, duration=60.0)
        values = recording.aiding["dvl"].values.copy()
        values[45] += 2.0
        wild = dict(recording.aiding) | {"dvl": Aiding(recording.aiding["dvl"].time, values)}
        other = InertialRecording(recording.time, recording.angle, recording.velocity, wild, recording.model)  # fmt: skip
        own, plain = (
            np.abs(np.subtract(*(estimated(n, InsBatch.of([r])).states[0, 230, 3:6] for r in (recording, other)))).max()
            for n in (name, "ins_kf")
        )  # fmt: skip
        assert own < 0.1 * plain

    def test_a_silent_imu_is_bridged_and_trusted_less(self):
        recording = made(seed=2, duration=60.0)
        angle, velocity = recording.angle.copy(), recording.velocity.copy()
        angle[3000:3100] = velocity[3000:3100] = np.nan
        gap = InertialRecording(recording.time, angle, velocity, recording.aiding, recording.model)
        one, other = (estimated("ins_kf", InsBatch.of([r])) for r in (recording, gap))
        assert other.covariances[0, 153, 3, 3] > 4.0 * one.covariances[0, 153, 3, 3]
        assert np.abs(one.states[0, -1, :2] - other.states[0, -1, :2]).max() < 1.0
        assert not other.diverged[0]

    def test_measurements_before_the_first_imu_sample_are_left_out(self):
        recording = made(seed=2, duration=10.0)
        early = dict(recording.aiding)
        dvl = early["dvl"]
        early["dvl"] = Aiding(np.r_[-3.0, dvl.time], np.vstack([[50.0, 0.0, 0.0], dvl.values]))
        other = InertialRecording(recording.time, recording.angle, recording.velocity, early, recording.model)  # fmt: skip
        one, two = (estimated("ins_kf", InsBatch.of([r])).states for r in (recording, other))
        np.testing.assert_array_equal(one, two)
