"""An estimate as others read it, and as people look at it."""

import csv
import json
import re
import sys
import warnings
import xml.etree.ElementTree as ET

import numpy as np
import pytest

import navgym


@pytest.fixture(scope="module")
def auv():
    return navgym.estimate("kf", navgym.simulate("auv/nominal", seed=1, steps=60))


@pytest.fixture(scope="module")
def deck():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return navgym.estimate("alignment", navgym.simulate("deck/paper", seed=1, duration=4.0))


@pytest.fixture(scope="module")
def ins():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return navgym.estimate("ins_kf", navgym.simulate("ins/nominal", seed=1, duration=20.0))


@pytest.fixture(scope="module")
def sailed():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return navgym.estimate("kf", navgym.read("csv", navgym.sample_log()))


@pytest.mark.parametrize("name", ["auv", "deck", "ins"])
def test_a_csv_holds_every_column_bit_for_bit(name, request, tmp_path):
    estimate = request.getfixturevalue(name)
    with estimate.to_csv(tmp_path / "e.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(estimate.time)
    for column, values in estimate.columns.items():
        read = np.array([float(row[column] or "nan") for row in rows])
        np.testing.assert_array_equal(read, values)


def test_columns_are_called_by_what_they_hold(auv, ins, deck):
    assert list(auv.columns)[:5] == ["time", "px", "vx", "py", "vy"]
    np.testing.assert_array_equal(ins.columns["heading"], ins.angles[:, 2])
    np.testing.assert_array_equal(ins.columns["sd_heading"], ins.deviations[:, 8])
    np.testing.assert_array_equal(deck.columns["static_z"], deck.static[:, 2])


@pytest.mark.parametrize("name", ["auv", "deck", "ins"])
def test_tum_has_a_time_a_place_and_a_unit_quaternion_in_each_row(name, request, tmp_path):
    estimate = request.getfixturevalue(name)
    rows = np.loadtxt(estimate.to_tum(tmp_path / "e.tum"))
    assert rows.shape == (len(estimate.time), 8)
    np.testing.assert_array_equal(rows[:, 0], estimate.time)
    np.testing.assert_allclose(np.linalg.norm(rows[:, 4:], axis=1), 1.0, atol=1e-8)
    np.testing.assert_allclose(rows[:, 1:4], estimate.pose[0], rtol=1e-8, atol=1e-9)


def test_the_attitude_of_an_ins_turns_body_into_north_east_down(ins):
    from scipy.spatial.transform import Rotation

    position, attitude = ins.pose
    forward = Rotation.from_quat(attitude).apply([1.0, 0.0, 0.0])
    np.testing.assert_allclose(np.arctan2(forward[:, 1], forward[:, 0]), ins.angles[:, 2])
    np.testing.assert_array_equal(position, ins.states[:, :3])


def test_places_are_those_that_geographic_tells(sailed):
    latitude, longitude = navgym.geographic(sailed.recording, sailed.states)
    np.testing.assert_allclose(sailed.places[:, :2], np.stack([latitude, longitude], axis=-1))


def test_places_of_an_ins_begin_where_it_starts(ins):
    model = ins.recording.model
    start = np.degrees([model.latitude, model.longitude])
    assert np.abs(ins.places[0, :2] - start).max() < 1e-4  # some metres


def test_geojson_is_a_line_of_longitude_latitude_and_height(sailed, tmp_path):
    found = json.loads(sailed.to_geojson(tmp_path / "e.geojson").read_text())
    (feature,) = found["features"]
    line = np.array(feature["geometry"]["coordinates"])
    np.testing.assert_allclose(line[:, :2], sailed.places[:, 1::-1], atol=1e-8)
    assert feature["properties"]["start"].startswith("2026-05-04T06:30")


def test_gpx_has_a_dated_point_per_step(sailed, tmp_path):
    root = ET.parse(sailed.to_gpx(tmp_path / "e.gpx")).getroot()
    points = root.findall(".//{*}trkpt")
    assert len(points) == len(sailed.time)
    assert float(points[5].get("lat")) == pytest.approx(sailed.places[5, 0], abs=1e-8)
    assert points[5].find("{*}time").text == "2026-05-04T06:30:01.000Z"


def test_without_an_origin_there_is_no_place(auv, tmp_path):
    with pytest.raises(ValueError, match="origin="):
        auv.to_gpx(tmp_path / "e.gpx")
    assert not (tmp_path / "e.gpx").exists()


@pytest.mark.parametrize(("name", "panels"), [("auv", 4), ("deck", 3), ("ins", 4)])
def test_a_plot_has_a_panel_for_all_that_is_known(name, panels, request, tmp_path):
    figure = request.getfixturevalue(name).plot(tmp_path / "e.png")
    assert len(figure.axes) == panels
    assert (tmp_path / "e.png").read_bytes()[:4] == b"\x89PNG"


def test_a_schedule_is_drawn():
    recording = navgym.simulate("auv/nominal", seed=1, steps=40)
    schedule = {"process_noise_scale": [1.0, 5.0, 2.0, 1.0], "forgetting": 0.9}
    figure = navgym.estimate("qivbf", recording, schedule, 10).plot()
    assert [t.get_text() for t in figure.axes[-1].get_legend().get_texts()] == [
        "process_noise_scale"
    ]


def test_plotting_says_what_to_install(auv, monkeypatch):
    monkeypatch.delitem(sys.modules, "navgym.plotting", raising=False)
    for name in [n for n in sys.modules if n.partition(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r"pip install 'navgym\[render\]'"):
        auv.plot()


def test_what_is_public_prints_in_a_few_letters(auv, deck, ins):
    shown = [
        auv,
        deck,
        ins,
        auv.recording,
        deck.recording,
        ins.recording,
        navgym.LinearModel(),
        navgym.DeckModel(),
    ]
    for each in shown:
        assert len(repr(each)) < 1500
        assert re.match(rf"<?{type(each).__name__}", repr(each))


def test_the_sample_log_is_read_with_what_its_logger_did_to_it():
    assert navgym.sample_log().stat().st_size < 300_000
    with pytest.warns(UserWarning, match="held"):
        log = navgym.read("csv", navgym.sample_log())
    said = " ".join(log.meta["reading"])
    assert all(
        word in said
        for word in ("decimal commas", "held", "sorted by time", "became metres", "receiver's own")
    )
    found = navgym.inspect(navgym.sample_log())
    assert {f.kind for f in found.findings} == {"held", "order"}


@pytest.mark.parametrize("parameters", [None, {"measurement_noise_scale": 0.01}])
def test_a_plot_s_innovations_are_as_far_off_as_the_filter_s_nis_says(parameters):
    found = navgym.estimate("kf", navgym.simulate("auv/nominal", seed=1, steps=200), parameters)
    axes = found.plot().axes[2]
    assert "over σ" in axes.get_ylabel()
    drawn = np.stack(
        [line.get_ydata() for line in axes.get_lines() if len(line.get_xdata()) == 200]
    )
    heard = ~found.recording.lost.any(axis=1)
    squares = (drawn[:, heard] ** 2).mean(axis=0)
    nis = found.nis[heard] / found.innovations.shape[1]
    assert squares.mean() == pytest.approx(nis.mean(), rel=0.1)  # axes of one covariance are mixed
