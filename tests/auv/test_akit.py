"""Readers: known answers from a miniature A-KIT folder, and the real tracks where they are."""

import math

import numpy as np
import pytest

import navgym
from navgym.auv.scenarios import Loss
from navgym.auv.simulation import draw_losses
from navgym.readers import ReaderOptions
from navgym.statespace.batch import StateSpaceBatch
from tests.helpers import run

GT_HEADER = (
    "Time [s],Longitude [rad],Latitude [rad],Altitude [m],V North [m/s],V East [m/s],V Down [m/s],"
    "Roll [rad],Pitch [rad],Yaw [rad]"
)
DVL_HEADER = "Time [s],DVL X [m/s],DVL Y [m/s],DVL Z [m/s]"
SPEED = 2.0


def write_track(folder, ned, body, attitude, time=None, latitude=0.5733, number=1):
    """A track that moves from (latitude, .6089) at constant `ned` velocity, as A-KIT writes it."""
    time = np.arange(20) * 1.5 if time is None else np.asarray(time)
    # radii of curvature at the start, here from the ellipse's semi-axes: N = a²/√(a²cos²φ+b²sin²φ)
    a, b = 6378137.0, 6356752.314245
    w = math.hypot(a * math.cos(latitude), b * math.sin(latitude))
    meridian, normal, height = (a * b) ** 2 / w**3, a**2 / w, -10.0
    lat = latitude + ned[0] * time / (meridian + height)
    lon = 0.6089 + ned[1] * time / ((normal + height) * math.cos(latitude))
    same = [np.full(len(time), v) for v in (height, *ned, *attitude)]
    gt = np.column_stack([time, lon, lat, *same])
    dvl = np.column_stack([time, *(np.full(len(time), v) for v in body)])
    folder.mkdir(exist_ok=True)
    for kind, header, table in (("GT", GT_HEADER, gt), ("DVL", DVL_HEADER, dvl)):
        lines = [header, *(",".join(repr(float(v)) for v in row) for row in table)]
        (folder / f"{kind}_trajectory{number}.csv").write_text("\n".join(lines) + "\n")
    return folder


@pytest.fixture
def eastward(tmp_path):
    return write_track(tmp_path, (0, SPEED, 0), (SPEED, 0, 0), (0, 0, math.pi / 2))


def test_bow_to_the_east_makes_forward_speed_east_velocity(eastward):
    recording = navgym.read("akit", eastward)
    assert np.allclose(recording.measurements[:, 1], 0.0, atol=1e-12)
    assert np.allclose(recording.measurements[:, 3], SPEED, atol=1e-12)


@pytest.mark.parametrize(
    ("attitude", "body", "ned"),
    [
        ((0, 0, 0), (1, 2, 0), (1, 2, 0)),  # bow north: starboard is east
        ((0, 0, math.pi), (1, 2, 0), (-1, -2, 0)),
        ((math.pi / 2, 0, 0), (0, 0, -1), (0, 1, 0)),  # rolled to starboard: up points east
        ((0, math.pi / 2, 0), (0, 0, 1), (1, 0, 0)),  # nose up: the keel points north
        ((0, math.pi / 6, math.pi / 2), (2, 0, 0), (0, math.sqrt(3), -1)),  # climbing eastwards
    ],
)
def test_body_velocity_is_turned_by_roll_pitch_yaw(tmp_path, attitude, body, ned):
    recording = navgym.read("akit", write_track(tmp_path, ned, body, attitude))
    assert np.allclose(recording.measurements[:, [1, 3]], ned[:2], atol=1e-12)


@pytest.mark.parametrize("latitude", [0.0, 0.5733, -1.2])
def test_truth_is_metres_north_and_east_of_the_first_sample(tmp_path, latitude):
    folder = write_track(tmp_path, (1.5, -2, 0), (1, 0, 0), (0, 0, 0), latitude=latitude)
    recording = navgym.read("akit", folder)
    assert np.allclose(recording.truth[:, 0], 1.5 * recording.time, atol=1e-5)
    assert np.allclose(recording.truth[:, 2], -2.0 * recording.time, atol=1e-5)
    assert np.allclose(recording.truth[:, [1, 3]], [1.5, -2.0])


def test_recording_starts_one_step_after_its_first_state(eastward):
    recording = navgym.read("akit", eastward)
    assert recording.time[0] == 1.5
    assert recording.model.x0.tolist() == [0.0, 0.0, 0.0, SPEED]
    assert np.array_equal(recording.model.P0, np.eye(4))
    assert recording.model.F[0, 1] == 1.5


def test_uneven_track_gets_a_step_per_sample(tmp_path):
    time = [0.0, 1.0, 3.0, 3.5]
    folder = write_track(tmp_path, (1, 0, 0), (1, 0, 0), (0, 0, 0), time=time)
    assert navgym.read("akit", folder).model.F[:, 0, 1].tolist() == [1.0, 2.0, 0.5]


def test_fixes_are_the_reference_plus_noise_of_the_asked_size(tmp_path):
    folder = write_track(tmp_path, (1, 0, 0), (1, 0, 0), (0, 0, 0), time=np.arange(4001.0))
    recording = navgym.read("akit", folder, position_noise=3.0)
    noise = (recording.measurements - recording.truth)[:, [0, 2]]
    assert noise.std() == pytest.approx(3.0, rel=0.03)
    assert abs(np.corrcoef(noise.T)[0, 1]) < 0.05
    assert np.diag(recording.model.R).tolist() == pytest.approx([9.0, 0.01, 9.0, 0.01])


def test_another_loss_leaves_the_noise_as_it_was(eastward):
    whole = navgym.read("akit", eastward, seed=3)
    lossy = navgym.read("akit", eastward, seed=3, loss=0.5)
    kept = ~lossy.lost
    assert 0 < lossy.loss_rate < 1
    assert np.array_equal(whole.measurements[kept], lossy.measurements[kept])


def test_seeds_and_tracks_have_noise_of_their_own(tmp_path):
    for number in (1, 2):
        write_track(tmp_path, (1, 0, 0), (1, 0, 0), (0, 0, 0), number=number)
    fixes = {
        (track, seed): navgym.read("akit", tmp_path, track=track, seed=seed).measurements[0, 0]
        for track in (1, 2)
        for seed in (0, 1)
    }
    assert len(set(fixes.values())) == 4
    assert fixes[1, 0] == navgym.read("akit", tmp_path, track=1, seed=0).measurements[0, 0]


def test_planned_outages_and_component_losses_reach_real_logs(eastward):
    outage = navgym.read("akit", eastward, loss=Loss(outages=1, outage_length=5))
    assert outage.lost.all(axis=1).nonzero()[0].tolist() == [7, 8, 9, 10, 11]
    separate = navgym.read("akit", eastward, loss=Loss(0.5, per_component=True))
    assert (separate.lost.any(axis=1) & ~separate.lost.all(axis=1)).any()


def test_real_logs_lose_samples_as_simulated_ones_do():
    loss, same = Loss(0.3, length=20), np.zeros(200_000, np.int64)
    lost = draw_losses(loss, [loss], same, 2, np.random.default_rng(0))[:, 0]
    bursts = np.diff(lost.astype(int), prepend=0) == 1
    assert lost.mean() == pytest.approx(0.3, abs=0.02)
    assert lost.sum() / bursts.sum() == pytest.approx(20.0, rel=0.05)


def test_a_model_of_positions_measures_positions(eastward):
    model = navgym.LinearModel(dt=1.5, H=np.eye(4)[[0, 2]])
    fixes = navgym.read("akit", eastward, model=model)
    assert np.array_equal(fixes.measurements, navgym.read("akit", eastward).measurements[:, [0, 2]])


def test_the_published_folders_are_found(tmp_path):
    write_track(tmp_path / "Trajectory4", (1, 0, 0), (1, 0, 0), (0, 0, 0), number=4)
    assert navgym.read("akit", tmp_path, track=4).meta["track"] == 4


@pytest.mark.parametrize("kind", ["GT", "DVL"])
def test_a_tracks_file_is_a_log_of_its_own(tmp_path, kind):
    for number in (1, 3):
        write_track(tmp_path, (0, number, 0), (number, 0, 0), (0, 0, math.pi / 2), number=number)
    file = tmp_path / f"{kind}_trajectory3.csv"
    recording = navgym.read("akit", file)
    assert recording.meta["track"] == 3
    same = navgym.read("akit", tmp_path, track=3)
    assert np.array_equal(recording.measurements, same.measurements)
    assert ReaderOptions().format_of(tmp_path / "GT_trajectory3.csv") == "akit"
    with pytest.raises(ValueError, match=r"trajectory3\.csv is of track 3, got track=1"):
        navgym.read("akit", file, track=1)


def test_a_track_that_has_changed_is_read_again(eastward):
    before = navgym.read("akit", eastward)
    write_track(eastward, (0, SPEED, 0), (2 * SPEED, 0, 0), (0, 0, math.pi / 2))
    after = navgym.read("akit", eastward)
    assert np.allclose(after.measurements[:, 3], 2 * before.measurements[:, 3])


def spoil(folder, old, new, kind="GT"):
    file = folder / f"{kind}_trajectory1.csv"
    file.write_text(file.read_text().replace(old, new))


@pytest.mark.parametrize(
    ("kind", "old", "new", "message"),
    [
        ("GT", "Yaw [rad]", "Heading [rad]", r"'Yaw \[rad\]'"),
        ("GT", "\n3.0,", "\n1.5,", r"GT_trajectory1.csv, line 4, column 'Time \[s\]'"),
        ("DVL", "\n3.0,2.0", "\n3.0,nan", r"line 4, column 'DVL X \[m/s\]': must be a finite"),
        ("GT", "\n3.0,0.6089", "\n3.0,inf", r"line 4, column 'Longitude \[rad\]'"),
        ("DVL", "\n28.5,", "\n29.5,", "same times"),
    ],
)
def test_a_spoiled_track_names_file_line_and_column(eastward, kind, old, new, message):
    spoil(eastward, old, new, kind)
    with pytest.raises(ValueError, match=message):
        navgym.read("akit", eastward)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tracks": 2}, "Did you mean 'track'"),
        ({"loss": 1.5}, "loss rate must be a number in 0..1"),
        ({"position_noise": 0.0}, "position_noise must be a finite number above 0"),
        ({"track": 1.0}, "track must be a whole number"),
        ({"seed": -1}, "seed must be a whole number of at least 0"),
        ({"model": navgym.LinearModel(F=np.eye(2))}, "model must be a navgym.LinearModel"),
    ],
)
def test_bad_options_are_named(eastward, options, message):
    with pytest.raises(ValueError, match=message):
        navgym.read("akit", eastward, **options)


def test_an_unknown_format_names_the_nearest():
    with pytest.raises(ValueError, match="Did you mean 'akit'"):
        navgym.read("a-kit", ".")


def test_an_absent_track_names_those_that_are_there(eastward):
    with pytest.raises(FileNotFoundError, match=r"its tracks: GT_trajectory1\.csv"):
        navgym.read("akit", eastward, track=9)
    with pytest.raises(FileNotFoundError, match="ansfl/A-KIT"):
        navgym.read("akit", eastward / "nowhere")


# --- the real tracks ------------------------------------------------------------------------------

TRACKS = range(1, 7)
SEEDS = range(10)
# Measured before this project by an independent prototype on other noise, ten seeds per track:
# mean position RMSE in m and its standard error: docs/science/qivbf.md#real-tracks.
PUBLISHED = {
    "kf": {0.1: (0.719, 0.014), 0.3: (0.816, 0.019), 0.5: (1.145, 0.053)},
    "kf_extrapolate": {0.1: (0.717, 0.014), 0.3: (0.797, 0.019), 0.5: (1.064, 0.053)},
}
ZEROS_FED = {0.1: 21.0, 0.3: 56.0, 0.5: 91.0}


@pytest.fixture(scope="module")
def real_rmse(akit):
    """Position RMSE by filter and loss rate, one per track and seed."""
    found = {}
    for loss in (0.1, 0.3, 0.5):
        batch = StateSpaceBatch.of(
            [navgym.read("akit", akit, track=n, loss=loss, seed=s) for n in TRACKS for s in SEEDS]
        )
        for name in ("kf", "kf_extrapolate", "kf_zero"):
            error = (run(name, batch).states - batch.truth)[..., [0, 2]]
            found[name, loss] = np.sqrt((error**2).sum(-1).mean(-1))
    return found


@pytest.mark.parametrize("name", PUBLISHED)
@pytest.mark.parametrize("loss", [0.1, 0.3, 0.5])
def test_real_tracks_reproduce_the_published_errors(real_rmse, name, loss):
    expected, standard_error = PUBLISHED[name][loss]
    assert abs(real_rmse[name, loss].mean() - expected) < standard_error


@pytest.mark.parametrize("loss", [0.1, 0.3, 0.5])
def test_zeros_fed_for_losses_ruin_the_filter_on_real_tracks(real_rmse, loss):
    assert real_rmse["kf_zero", loss].mean() == pytest.approx(ZEROS_FED[loss], rel=0.05)


def test_extrapolation_earns_its_place_at_half_the_samples_lost(real_rmse):
    gain = real_rmse["kf_extrapolate", 0.5] - real_rmse["kf", 0.5]
    standard_error = gain.std(ddof=1) / math.sqrt(len(gain))
    assert gain.mean() + 2 * standard_error < 0.0


@pytest.mark.parametrize("track", TRACKS)
def test_turned_dvl_velocity_agrees_with_the_reference(akit, track):
    recording = navgym.read("akit", akit, track=track)
    difference = (recording.measurements - recording.truth)[:, [1, 3]]
    rms = np.sqrt((difference**2).mean(axis=0))
    assert (rms > 0.05).all()
    assert (rms < 0.19).all()
    assert (np.abs(difference.mean(axis=0)) < 0.02).all()  # no misread angle, no wrong scale


@pytest.mark.parametrize("track", TRACKS)
def test_what_is_left_of_the_velocity_difference_is_the_lever_arm(akit, track):
    """Rigid body: v_dvl − v_ref = ω × l, so its starboard part is yaw rate times the arm ahead."""
    recording = navgym.read("akit", akit, track=track)
    vn, ve = recording.truth[:, 1], recording.truth[:, 3]
    course = np.unwrap(np.arctan2(ve, vn))
    difference = (recording.measurements - recording.truth)[:, [1, 3]]
    starboard = difference[:, 1] * np.cos(course) - difference[:, 0] * np.sin(course)
    arm = np.polyfit(np.gradient(course, recording.time), starboard, 1)[0]
    assert -2.2 < arm < -1.0  # m: the DVL sits aft of the reference point in every track


@pytest.mark.parametrize("track", TRACKS)
def test_reference_position_and_velocity_belong_together(akit, track):
    recording = navgym.read("akit", akit, track=track)
    p, v = recording.truth[:, [0, 2]], recording.truth[:, [1, 3]]
    moved = np.diff(p, axis=0)
    expected = (v[1:] + v[:-1]) / 2 * np.diff(recording.time)[:, None]
    assert np.abs((moved - expected).sum(axis=0)).max() < 0.02 * np.abs(moved).sum()
