"""Each kind of log against the voyage that it was written from, and what is said and refused."""

import dataclasses
import re
import sys

import numpy as np
import pytest

import navgym
from navgym import command
from navgym.auv.csv_log import read_csv
from navgym.auv.geodesy import to_plane
from navgym.formats.channels import KINDS
from navgym.formats.kinds import kind_of, read_channels
from navgym.statespace.models import LinearModel
from tests.formats import writers
from tests.formats.writers import GRAVITY, WRITERS, Mount, Voyage

VOYAGE = Voyage()
# by log: what its digits can hold, m and m/s; the rest is the library's business
FINE = {
    "nmea": (1e-3, 1e-5), "nmea_vtg": (1e-3, 1e-5), "mcap": (1e-6, 1e-6), "sqlite3": (1e-6, 1e-6), "ros1": (1e-6, 1e-6),
    "ulog": (1e-6, 1e-6), "ardupilot": (0.02, 1e-5), "tlog": (0.02, 1e-3), "sbet": (1e-6, 1e-6),
    "pd0": (None, 2e-3), "mcap_crc": (None, 1e-9),
}  # fmt: skip


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """A log of each kind, by the name of its writer."""
    folder = tmp_path_factory.mktemp("logs")
    return {name: write(folder / file) for name, (write, file) in WRITERS.items()}


def channel(path, kind, name=None):
    found = [c for c in read_channels(path).of(kind) if name in (None, c.name)]
    assert len(found) == 1
    return found[0]


@pytest.mark.parametrize("name", WRITERS)
def test_a_log_reads_as_the_voyage_that_it_was_written_from(logs, name):
    log = navgym.read("log", logs[name])
    place, speed = FINE[name]
    assert len(log) == VOYAGE.count
    assert np.allclose(np.diff(log.time), VOYAGE.step, atol=1e-6)
    heard = ~log.lost
    assert heard.all(axis=1).sum() >= 0.7 * len(log)
    y = log.measurements
    if place is not None:
        truth = to_plane(*VOYAGE.places.T, (*VOYAGE.places[0], 33.0), None)[:, :2]
        both = heard[:, [0, 2]].all(axis=1)
        assert np.abs(y[both][:, [0, 2]] - truth[both]).max() < place
    v = y[:, [1, 3]] if place is not None else y
    assert np.nanmax(np.abs(v - VOYAGE.velocity[:, :2])) < speed


@pytest.mark.parametrize("name", WRITERS)
def test_a_kind_is_known_by_its_content_whatever_the_name(logs, name, tmp_path):
    source = logs[name]
    assert navgym.readers.guess(source) == "log"
    if source.is_file() and name not in ("tlog", "sbet"):  # which nothing within sets apart
        other = tmp_path / "unnamed"
        other.write_bytes(source.read_bytes())
        assert kind_of(other) == kind_of(source)


def test_single_files_of_a_bag_read_as_the_folder(logs):
    for name, file in (("mcap", "mcap.mcap"), ("sqlite3", "sqlite3.db3")):
        whole, part = navgym.read("log", logs[name]), navgym.read("log", logs[name] / file)
        assert np.array_equal(whole.measurements, part.measurements, equal_nan=True)


def test_a_second_writer_of_mcap_is_read_too(tmp_path):
    path = writers.mcap_crc(tmp_path / "other.mcap")
    assert np.array_equal(navgym.read("log", path).measurements, VOYAGE.velocity[:, :2])


# ---- channels


class TestROS:
    def test_inertial_axes_become_forward_starboard_down(self, logs):
        imu = channel(logs["mcap"], "imu")
        assert np.allclose(imu.values, [0.0, 0.0, 0.02, 0.1, -0.2, -GRAVITY])

    def test_orientations_become_roll_pitch_heading(self, logs):
        for name in ("/imu", "/odom"):
            attitude = channel(logs["ros1"], "attitude", name)
            assert np.allclose(attitude.values[:, :2], 0.0, atol=1e-12)
            assert np.allclose(attitude["heading"], VOYAGE.heading)

    def test_covariances_become_deviations_along_our_axes(self, logs):
        fix = channel(logs["mcap"], "fix")
        heard = ~np.isnan(fix["lat"])
        assert np.allclose(fix["sigma_east"][heard], 0.5)
        assert np.allclose(fix["sigma_north"][heard], 0.4)
        body = channel(logs["mcap"], "body_velocity", "/odom")
        assert np.allclose(body.values[:, 3:], [0.1, 0.2, 0.3])

    def test_a_message_without_a_fix_is_a_lost_one(self, logs):
        assert np.flatnonzero(np.isnan(channel(logs["mcap"], "fix")["lat"])).tolist() == [3]

    def test_frames_called_ned_are_not_turned(self, tmp_path):
        store = writers.typestore()
        T = store.types
        twist = T["geometry_msgs/msg/Twist"](*[writers._vector(store, (1.0, 2.0, 3.0))] * 2)
        more = [
            (topic, "geometry_msgs/msg/TwistStamped", writers.START + k * 10**9,
             T["geometry_msgs/msg/TwistStamped"](writers.header(store, writers.START + k * 10**9, frame), twist))
            for topic, frame in (("/a", "map_ned"), ("/b", "map"), ("/c", "body_frd"), ("/d", "body"))
            for k in range(3)
        ]  # fmt: skip
        path = writers.bag(tmp_path / "frames", dataclasses.replace(VOYAGE, count=0), more=more)
        found = {c.name: (c.kind, c.values[0, :3].tolist()) for c in read_channels(path).found}
        assert found == {
            "/a": ("velocity", [1.0, 2.0, 3.0]), "/b": ("velocity", [2.0, 1.0, -3.0]),
            "/c": ("body_velocity", [1.0, 2.0, 3.0]), "/d": ("body_velocity", [1.0, -2.0, -3.0]),
        }  # fmt: skip

    def test_a_message_without_a_stamp_has_the_bags(self, tmp_path):
        store = writers.typestore()
        make = store.types["geometry_msgs/msg/TwistStamped"]
        twist = store.types["geometry_msgs/msg/Twist"](
            *[writers._vector(store, (1.0, 2.0, 3.0))] * 2
        )
        more = [("/v", "geometry_msgs/msg/TwistStamped", writers.START + k, make(writers.header(store, 0, "map"), twist)) for k in range(2)]  # fmt: skip
        path = writers.bag(tmp_path / "late", dataclasses.replace(VOYAGE, count=0), more=more)
        found = read_channels(path)
        assert found.found[0].time.tolist() == [
            writers.START + 5_000_000,
            writers.START + 5_000_001,
        ]
        assert "no stamp" in found.doubts[0]


class TestNMEA:
    def test_accuracies_and_heights_stand_beside_their_fixes(self, logs):
        fix = channel(logs["nmea"], "fix")
        assert np.allclose(fix.values[:, 2:], [33.0, 0.8, 0.7, 1.5])

    def test_the_clock_passes_midnight(self, logs):
        assert np.array_equal(channel(logs["nmea"], "fix").time, VOYAGE.stamps)

    def test_without_a_date_times_count_from_midnight(self, tmp_path):
        path = writers.nmea(tmp_path / "x.nmea", course="VTG")
        fix = channel(path, "fix")
        assert np.array_equal(fix.time - fix.time[0], VOYAGE.stamps - VOYAGE.stamps[0])
        assert fix.time[0] == (24 * 3600 - 30) * 10**9
        log = navgym.read("log", path)
        assert np.nanmax(np.abs(log.measurements[:, [1, 3]] - VOYAGE.velocity[:, :2])) < 1e-5

    def test_headings_serve_a_lever_arm(self, logs):
        plain, moved = (
            navgym.read("log", logs["nmea"], **o) for o in ({}, {"lever_arm": (3.0, 1.0)})
        )
        h = VOYAGE.heading
        arm = np.column_stack([3 * np.cos(h) - np.sin(h), 3 * np.sin(h) + np.cos(h)])
        found = (plain.measurements - moved.measurements)[:, [0, 2]]
        assert np.allclose(found[:-1], arm[:-1], atol=1e-4)
        assert moved.lost[-1, 0]  # whose heading may be of a moment that the file has lost

    def test_a_sentence_without_a_time_counts_only_where_nothing_can_be_missing(self, tmp_path):
        path = writers.nmea(tmp_path / "x.nmea", course="VTG")
        lines = path.read_bytes().splitlines(keepends=True)  # GGA, GST, VTG, HDT of each moment
        heading = channel(path, "attitude")["heading"]
        of_two = channel(path, "attitude").time[1:3]

        def headings(lines):
            path.write_bytes(b"".join(lines))
            found = channel(path, "attitude")
            return dict(zip(found.time.tolist(), found["heading"].tolist(), strict=True))

        kept = headings(lines)
        assert list(kept.values()) == heading.tolist()
        assert len(kept) == VOYAGE.count - 1
        for gone in (
            [7, 8, 9, 10],  # the heading of moment 1, and what tells the time of moment 2
            [5, 7, 8, 9, 10],
            [8, 9],  # a second heading follows within moment 1
        ):
            left = [line for k, line in enumerate(lines) if k not in gone]
            found = headings(left)
            assert all(kept.get(stamp) == told for stamp, told in found.items())
            assert len(kept) - 3 <= len(found) < len(kept)
        twice = headings(lines[:10] + lines[7:10] + lines[10:])  # moment 2 follows itself
        assert of_two[1] not in twice

    def test_a_file_without_dates_says_that_it_counts_from_midnight(self, tmp_path):
        dated = navgym.read("log", writers.nmea(tmp_path / "a.nmea"))
        dateless = navgym.read("log", writers.nmea(tmp_path / "b.nmea", course="VTG"))
        said = [
            "no sentence tells a date" in " ".join(log.meta["reading"]) for log in (dated, dateless)
        ]
        assert said == [False, True]

    def test_other_sentences_between_do_no_harm(self, tmp_path):
        path = writers.nmea(tmp_path / "x.nmea", course="VTG")
        before = channel(path, "velocity")
        lines = path.read_bytes().splitlines(keepends=True)
        path.write_bytes(
            b"".join(b"!AIVDM,1,1,,A,1,0*26\r\n$GPGSV,1,1,00*79\r\n" + x for x in lines)
        )
        after = channel(path, "velocity")
        assert np.array_equal(before.time, after.time)
        assert np.array_equal(before.values, after.values, equal_nan=True)

    def test_a_wrong_checksum_is_left_out_and_counted(self, logs, tmp_path):
        lines = logs["nmea"].read_bytes().split(b"\r\n")
        lines[4] = lines[4].replace(b"5918", b"5919")
        path = tmp_path / "x.nmea"
        path.write_bytes(b"\r\n".join(lines))
        with pytest.warns(UserWarning, match="1 of 240 sentences are damaged"):
            log = navgym.read("log", path)
        assert np.isnan(log.measurements[:, 0]).nonzero()[0].tolist() == [1]

    def test_a_clock_that_was_set_is_refused(self, tmp_path):
        late = dataclasses.replace(VOYAGE, count=3, start=writers.START + 3 * 86_400 * 10**9)
        first, second = writers.nmea(tmp_path / "a"), writers.nmea(tmp_path / "b", late)
        first.write_bytes(first.read_bytes() + second.read_bytes())
        with pytest.raises(ValueError, match="a clock was set"):
            read_channels(first)


def test_autopilots_tell_imu_attitude_and_accuracy(logs):
    for name in ("ulog", "ardupilot", "tlog"):
        found = read_channels(logs[name])
        imu = next(c for c in found.of("imu"))
        assert np.allclose(imu["acc_z"], -GRAVITY, rtol=2e-4)
        assert np.allclose(imu["gyro_z"], 0.02)
        attitude = found.of("attitude")[0]
        assert np.allclose(attitude["heading"], VOYAGE.heading, atol=1e-6)
        fix = next(c for c in found.of("fix"))
        assert np.allclose(fix.values[:, 2:], [33.0, 0.8, 0.8, 1.5])
        velocity = next(c for c in found.of("velocity") if c.rank == 0)
        assert np.allclose(velocity["sigma_vn"], 0.2)


@pytest.mark.parametrize("hand", [(-1.0, -1.0, -1.0), (-1.0, 1.0, 1.0), (1.0, -1.0, 1.0)])
def test_positions_tell_the_axes_of_an_sbet(tmp_path, hand):
    path = writers.sbet(tmp_path / "x.sbet", hand=hand)
    velocity = channel(path, "velocity")
    assert np.allclose(velocity.values[:, :2], VOYAGE.velocity[:, :2])
    attitude = channel(path, "attitude")
    assert np.allclose(np.cos(attitude["heading"] - VOYAGE.heading), 1.0)


def test_an_sbet_whose_velocities_fit_no_axes_has_none(tmp_path):
    path = writers.sbet(tmp_path / "x.sbet")
    rows = np.fromfile(path).reshape(-1, 17)
    rows[:, 4] += 3.0
    rows.tofile(path)
    found = read_channels(path)
    assert not found.of("velocity")
    assert "left out" in found.doubts[0]


def test_a_doppler_log_in_ship_axes_is_turned_by_its_heading(tmp_path):
    log = navgym.read("log", writers.pd0(tmp_path / "x", axes=2))
    assert np.nanmax(np.abs(log.measurements - VOYAGE.velocity[:, :2])) < 1e-3


MOUNTS = {
    "level": Mount(),
    "tilted": Mount(pitch=4.0, roll=-7.0),
    "beam 3 to starboard of the bow": Mount(pitch=-3.0, roll=2.0, alignment=45.0),
    "under ice": Mount(pitch=3.0, roll=5.0, up=True, alignment=-10.0),
    "beams that converge": Mount(roll=6.0, convex=False, alignment=120.0),
    "steep": Mount(pitch=2.0, angle=30, told=30),
    "by the configuration alone": Mount(pitch=2.0, angle=30, told=0),
    "one beam silent": Mount(pitch=2.0, roll=3.0, silent=(2,)),
}


@pytest.mark.parametrize("axes", [0, 1])
@pytest.mark.parametrize("name", MOUNTS)
def test_a_doppler_log_s_own_axes_are_turned_to_the_vessel_s(name, axes, tmp_path):
    mount = MOUNTS[name]
    if mount.silent and axes:
        mount = dataclasses.replace(mount, silent=(3,))  # which is the misfit
    body = channel(writers.pd0(tmp_path / "x", axes=axes, mount=mount), "body_velocity")
    heard = np.arange(VOYAGE.count) % 7 != 6
    assert np.array_equal(~np.isnan(body["u"]), heard)
    # whole mm along beams: half of one, over the sine of 20 degrees
    assert np.abs(body.values[heard, :3] - VOYAGE.body[heard]).max() < 3e-3


def test_the_pitch_of_a_sensor_within_is_none_of_a_gimbal(tmp_path):
    path = writers.pd0(tmp_path / "x", axes=1, mount=Mount(pitch=10.0, roll=30.0))
    content = path.read_bytes()
    size = len(content) // VOYAGE.count
    within = bytearray()
    for k in range(VOYAGE.count):
        one = bytearray(content[k * size : (k + 1) * size - 2])
        one[12 + 30] = 1 << 3  # pitch is of the tilt sensor
        tilt = np.degrees(np.arctan(np.tan(np.radians(10.0)) / np.cos(np.radians(30.0))))
        one[12 + 59 + 20 : 12 + 59 + 22] = round(100 * tilt).to_bytes(2, "little")
        within += one + (sum(one) & 0xFFFF).to_bytes(2, "little")
    path.write_bytes(within)
    body = channel(path, "body_velocity")
    assert np.nanmax(np.abs(body.values[:, :3] - VOYAGE.body)) < 2e-3


@pytest.mark.parametrize(
    ("change", "said"),
    [({"angle": 25, "told": 0}, "angle of these"), ({"silent": (0, 1)}, "holds no position")],
)
def test_beams_of_which_no_velocity_can_be_made_are_refused(change, said, tmp_path):
    path = writers.pd0(tmp_path / "x", axes=0, mount=dataclasses.replace(Mount(), **change))
    with pytest.raises(ValueError, match=said):
        navgym.read("log", path)


def test_a_doppler_log_of_three_beams_is_refused(tmp_path):
    path = writers.pd0(tmp_path / "x", axes=0)
    content = bytearray(path.read_bytes())
    size = len(content) // VOYAGE.count
    for k in range(0, len(content), size):
        content[k + 12 + 8] = 3
        content[k + size - 2 : k + size] = (sum(content[k : k + size - 2]) & 0xFFFF).to_bytes(2, "little")  # fmt: skip
    path.write_bytes(content)
    with pytest.raises(ValueError, match="along 3 beams"):
        navgym.read("log", path)


def test_packets_that_a_link_lost_are_counted_by_their_numbers(tmp_path):
    whole = writers.tlog(tmp_path / "x.tlog")
    assert not any("link" in each for each in read_channels(whole).said)
    content, at, kept = whole.read_bytes(), 0, bytearray()
    for k in range(4 * VOYAGE.count):  # each 12 bytes longer than its payload, after 8 of a stamp
        end = at + 8 + content[at + 9] + 12
        kept += b"" if 40 <= k < 52 else content[at:end]
        at = end
    whole.write_bytes(kept)
    (said,) = [each for each in read_channels(whole).said if "link" in each]
    assert said.startswith("by their numbers 12 of 240 packets (5.0%) were lost")


def test_a_dataflash_log_may_be_cut_off_within_a_message(tmp_path):
    path = writers.dataflash(tmp_path / "x.bin")
    path.write_bytes(path.read_bytes()[:-10])
    found = read_channels(path)
    assert found.doubts == ["the last message was cut off: left out"]
    assert len(channel(path, "fix")) == VOYAGE.count


def test_logs_from_before_microseconds_are_read(tmp_path):
    path = writers.dataflash(tmp_path / "new.bin")
    old = tmp_path / "old.bin"
    content = path.read_bytes()
    for name in (
        b"TimeUS,I,Status",
        b"TimeUS,I,VAcc",
        b"TimeUS,I,Gyr",
        b"TimeUS,Roll",
        b"TimeUS,C,",
    ):
        content = content.replace(name, name.replace(b"TimeUS", b"TimeMS"))
    old.write_bytes(content)
    new, told = channel(path, "fix"), channel(old, "fix")
    assert np.array_equal(told.values, new.values, equal_nan=True)
    assert np.array_equal(told.time, new.time * 1000)  # the same number, in ms


def test_a_receiver_s_own_sentences_alone_are_nmea_of_no_use(tmp_path):
    path = tmp_path / "x.log"
    path.write_bytes(b"$PFEC,GPatt,12.345,23.456,12.6*45\r\n" * 20)
    with pytest.raises(ValueError, match="holds nothing of use"):
        navgym.read(navgym.readers.guess(path), path)


# ---- what counts


def test_two_sensors_that_could_be_meant_are_an_error_that_tells_how_to_choose(tmp_path):
    path = writers.bag(tmp_path / "both")
    with pytest.raises(ValueError, match=r"/log/twist and /dvl could each be the velocity"):
        navgym.read("log", path)
    log = navgym.read("log", path, topics={"velocity": "/log/twist"})
    assert np.nanmax(np.abs(log.measurements[:, [1, 3]] - VOYAGE.velocity[:, :2])) < 1e-6
    none = navgym.read("log", path, topics={"velocity": "none"})
    assert none.measurements.shape[1] == 2


def test_an_estimate_counts_only_where_there_is_no_sensor(tmp_path):
    path = writers.bag(tmp_path / "odom", without=("/gps/fix", "/dvl", "/log/twist"))
    log = navgym.read("log", path)
    assert np.nanmax(np.abs(log.measurements[:, [0, 2]] - VOYAGE.position[:, :2])) < 1e-6
    fixed = navgym.read("log", writers.bag(tmp_path / "fix", without=("/dvl", "/log/twist")))
    assert fixed.measurements.shape[1] == 2
    assert any("/odom left out as velocity" in line for line in fixed.meta["reading"])


def test_options_of_text_logs_mean_the_same(logs, tmp_path):
    log = navgym.read("log", logs["ulog"], latency={"velocity": 0.5}, accuracy_floor=3.0)
    assert np.allclose(np.diff(log.time), 0.5)
    assert np.allclose(np.sqrt(np.nanmax(log.model.R[:, 0, 0])), 3.0)
    mapping = tmp_path / "map.toml"
    mapping.write_text('format = "log"\n[column."vehicle_local_position.north"]\nquantity = "px"\n')
    with pytest.raises(ValueError, match=r"vehicle_local_position\.north"):
        navgym.read(mapping, logs["ulog"])  # of a channel that was not chosen
    mapping.write_text(
        'format = "log"\ntopics.position = "vehicle_local_position"\nlatency.position = 0.2\n'
    )
    moved = navgym.read(mapping, logs["ulog"])
    assert (
        np.nanmax(np.abs(moved.measurements[:, 0][~moved.lost[:, 0]] - VOYAGE.position[:, 0]))
        < 1e-5
    )


def test_depth_counts_where_the_model_has_a_third_axis(logs):
    F = np.kron(np.eye(3), [[1.0, 1.0], [0.0, 1.0]])
    model = LinearModel(F=F, P0=100.0 * np.eye(6), position=(0, 2, 4), velocity=(1, 3, 5))
    log = navgym.read("log", logs["ulog"], model=model)
    assert np.allclose(log.measurements[:, 4], 0.0, atol=1e-2)


# ---- what is refused


def test_what_holds_no_position_says_what_it_holds(tmp_path):
    path = writers.bag(tmp_path / "imu", without=("/gps/fix", "/dvl", "/log/twist", "/odom"))
    with pytest.raises(ValueError, match="no position and no velocity, but /imu"):
        navgym.read("log", path)


def test_numbers_that_cannot_be_are_refused(tmp_path):
    path = writers.sbet(tmp_path / "x.sbet")
    rows = np.fromfile(path).reshape(-1, 17)
    rows[5, 1] = 3.0
    rows.tofile(path)
    with pytest.raises(ValueError, match=r"x\.sbet.*record 6 holds a lat of 3"):
        read_channels(path)


def test_absent_and_foreign_files_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        navgym.read("log", tmp_path / "nowhere.bag")
    other = tmp_path / "x.txt"
    other.write_text("hello")
    with pytest.raises(ValueError, match=r"x\.txt is no log of a kind that is known"):
        navgym.read("log", other)


def test_an_absent_package_is_named_with_its_extra(logs, monkeypatch):
    monkeypatch.setitem(sys.modules, "pynmeagps", None)
    monkeypatch.delitem(sys.modules, "navgym.formats.nmea", raising=False)
    with pytest.raises(ImportError, match=r"pip install 'navgym\[nmea\]'"):
        navgym.read("log", logs["nmea"])


def test_the_command_reads_each_without_options(logs, capsys):
    for name, path in logs.items():
        assert command.main(["read", str(path)]) == 0, name
    assert "navgym tune" in capsys.readouterr().out


def test_the_page_names_every_message_and_quantity():
    from pathlib import Path

    from navgym.formats import ros, tlog, ulog
    from navgym.formats.dataflash import MESSAGES

    page = (Path(__file__).parents[2] / "docs" / "formats.md").read_text()
    for name in (*ros.TAKERS, *tlog.TAKERS, *ulog.MESSAGES, *MESSAGES):
        assert re.search(rf"\b{name.rpartition('/')[2]}\b", page), name
    for kind, quantities in KINDS.items():
        assert f"`{kind}`" in page
        assert all(f"`{q}`" in page for q in quantities), kind


def test_text_logs_are_still_text_logs(tmp_path):
    path = tmp_path / "mine.csv"
    path.write_text("time,px,py\n" + "".join(f"{k},{k},{k}\n" for k in range(5)))
    assert navgym.readers.guess(path) == "csv"
    assert len(read_csv(path)) == 5
