"""Logs as people have them: what is read, and what is said of it."""

import gzip
import itertools
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import navgym
from navgym.auv.csv_log import write_csv
from navgym.core.repeats import is_held, repeats

ROWS = 30
RNG = np.random.default_rng(12)
P = np.cumsum(RNG.normal(0.5, 0.1, (ROWS, 2)), axis=0)  # m
V = RNG.normal(0.5, 0.1, (ROWS, 2))  # m/s
PLAIN = "time,px,vx,py,vy\n" + "".join(
    f"{k},{p[0]:.4f},{v[0]:.4f},{p[1]:.4f},{v[1]:.4f}\n"
    for k, (p, v) in enumerate(zip(P, V, strict=True))
)


@pytest.fixture
def log(tmp_path):
    """Writes a text as a log and returns its path."""

    def write(text, encoding="utf-8"):
        path = tmp_path / "log.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
        return path

    return write


def quietly(path, **options):
    """The recording, where nothing is doubtful."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return navgym.read("csv", path, **options)


def doubting(path, match, **options):
    """The recording, where a warning says `match`."""
    with pytest.warns(UserWarning, match=match):
        return navgym.read("csv", path, **options)


def said(recording):
    return "\n".join(recording.meta["reading"])


def lines(names, rows):
    return "\n".join([names, *(",".join(str(cell) for cell in row) for row in rows)]) + "\n"


class TestLayouts:
    """The same numbers in any layout are the same recording."""

    @pytest.fixture
    @staticmethod
    def plain(log):
        return quietly(log(PLAIN))

    LAYOUTS = {
        "semicolons": PLAIN.replace(",", ";"),
        "tabs": PLAIN.replace(",", "\t"),
        "bars": PLAIN.replace(",", " | "),
        "blanks": PLAIN.replace(",", "   "),
        "aligned": "\n".join(
            "".join(f"{cell:>14}" for cell in line.split(",")) for line in PLAIN.splitlines()
        ),
        "decimal commas": PLAIN.replace(",", ";").replace(".", ","),
        "decimal commas between tabs": PLAIN.replace(",", "\t").replace(".", ","),
        "Windows": PLAIN.replace("\n", "\r\n"),
        "old Macs": PLAIN.replace("\n", "\r"),
        "byte order mark": "\ufeff" + PLAIN,
        "a delimiter at each end": PLAIN.replace("\n", ",\n"),
        "a delimiter at the end of rows": PLAIN.replace("\n", ",\n").replace("vy,", "vy"),
        "quotes": '"' + PLAIN.replace(",", '","').strip().replace("\n", '"\n"') + '"\n',
        "comments": "# made by hand\n% so\n// it is\n" + PLAIN.replace("\n3,", "\n# a break\n3,"),
        "names in a comment": "# log of a day\n# " + PLAIN,
        "a preamble": "Device: 12\nDate of export, 3.4.2026\n\n" + PLAIN,
        "units below": PLAIN.replace("vy\n", "vy\ns,m,m/s,m,m/s\n"),
        "units below in brackets": PLAIN.replace("vy\n", "vy\n[s],[m],[m/s],[m],[m/s]\n"),
        "units in brackets": PLAIN.replace(
            "time,px,vx,py,vy", "Time [s],PX (m), VX (m/s) ,py {m},vy [m/s]"
        ),
        "units after an underscore": PLAIN.replace(
            "time,px,vx,py,vy", "time_s,px_m,vx_m/s,py_m,vy_m/s"
        ),
        "other names": PLAIN.replace("time,px,vx,py,vy", "Timestamp,North,Vel N,East,v_east"),
        "long names": PLAIN.replace(
            "time,px,vx,py,vy", "Elapsed time,pos. x,Velocity X,pos. y,Velocity Y"
        ),
        "names with blanks between blanks": PLAIN.replace(",", "  ").replace(
            "time  px", "time (s)  px (m)"
        ),
        "blank lines": PLAIN.replace("\n", "\n\n") + "\n,,,,\n",
        "names of topics": PLAIN.replace("time,px", "%time,field.pose.position.x").replace(
            ",py", ",field.pose.position.y"
        ),
        "a typesetter's minus": PLAIN.replace("-", "\u2212"),
        "UTF-16": PLAIN.encode("utf-16"),
        "UTF-16 without a mark": PLAIN.encode("utf-16-le"),
        "gzip": gzip.compress(PLAIN.encode()),
        "NUL bytes at the end": PLAIN.encode() + b"\0" * 512,
        "a last row that was cut off": PLAIN + "30,1.2",
        "Latin-1": ("# Länge\n" + PLAIN).encode("latin-1"),
    }

    @pytest.mark.parametrize("name", LAYOUTS)
    def test_the_layout_does_not_matter(self, plain, log, name):
        found = quietly(log(self.LAYOUTS[name]))
        assert np.array_equal(found.time, plain.time)
        assert np.array_equal(found.measurements, plain.measurements)

    @pytest.mark.parametrize(
        ("name", "words"),
        [
            ("decimal commas", "decimal commas"), ("gzip", "unpacked by gzip"),
            ("UTF-16", "UTF-16"), ("Latin-1", "Latin-1"),
            ("a last row that was cut off", "line 32, the last, was cut off"),
            ("NUL bytes at the end", "NUL"), ("units below", "line 2 holds units"),
            ("names in a comment", "the names stand in a comment, line 2"),
            ("a preamble", "the names stand in line 4"),
        ],
    )  # fmt: skip
    def test_what_was_done_is_said(self, log, name, words):
        assert words in said(quietly(log(self.LAYOUTS[name])))

    def test_columns_of_no_use_are_left_out_with_a_word(self, log):
        found = quietly(log("time,px,Battery,Mode\n0,1,99,AUTO\n1,2,98,AUTO\n"))
        assert "left out, of no use here: 'Battery', 'Mode'" in said(found)
        with pytest.raises(ValueError, match=r"unknown column of log.csv: 'Battery'"):
            navgym.read("csv", log("time,px,Battery\n0,1,9\n"), extra="raise")

    def test_options_go_before_what_was_found(self, log):
        text = "time;px;py\n0;1,5;2\n1;2,5;3\n"
        assert quietly(log(text), delimiter=";", decimal=",").measurements[0].tolist() == [1.5, 2]
        with pytest.raises(ValueError, match=r"line 2, column 'px'.*'1,5'"):
            navgym.read("csv", log(text), delimiter=";", decimal=".")


class TestNames:
    @pytest.mark.parametrize(
        ("header", "hint"),
        [
            ("time,x,north,py", r"'x' and 'north' could each be px: .*columns=\{'px': 'x'\}"),
            ("stamp,timestamp,px,py", r"could each be time: .*columns=\{'time': 'stamp'\}"),
            ("time,x,lat,lon", r"'x' and 'lat' and 'lon' all hold a position"),
        ],
    )
    def test_two_candidates_are_an_error_that_shows_both(self, log, header, hint):
        with pytest.raises(ValueError, match=hint):
            navgym.read("csv", log(f"{header}\n0,1,2,3\n1,2,3,4\n"))

    def test_the_users_word_decides(self, log):
        path = log("time,x,north,py\n0,1,2,3\n1,2,4,4\n")
        assert quietly(path, columns={"px": "north"}).measurements[:, 0].tolist() == [2, 4]

    def test_a_column_of_the_very_name_goes_before_its_synonyms(self, log):
        path = log("time,stamp,x,px\n0,7,9,1\n1,8,9,2\n")
        assert quietly(path).measurements[:, 0].tolist() == [1, 2]


class TestUnits:
    @pytest.mark.parametrize(
        ("unit", "metres"),
        [("m", 1), ("km", 1000), ("cm", 0.01), ("mm", 0.001), ("ft", 0.3048), ("Feet", 0.3048)],
    )
    def test_lengths_become_metres(self, log, unit, metres):
        found = quietly(log(f"time,px [{unit}],py\n0,1,2\n1,3,4\n"))
        assert found.measurements.tolist() == [[metres, 2], [3 * metres, 4]]
        told = quietly(log("time,px,py\n0,1,2\n1,3,4\n"), units={"px": unit})
        assert told.measurements.tolist() == found.measurements.tolist()

    @pytest.mark.parametrize(
        ("unit", "speed"),
        [
            ("m/s", 1),
            ("km/h", 1 / 3.6),
            ("knots", 1852 / 3600),
            ("kn", 1852 / 3600),
            ("cm/s", 0.01),
        ],
    )
    def test_speeds_become_metres_per_second(self, log, unit, speed):
        found = quietly(log(f"time,vx ({unit}),vy\n0,1,2\n1,3,4\n"))
        assert found.measurements[:, 0].tolist() == pytest.approx([speed, 3 * speed])

    @pytest.mark.parametrize(
        ("unit", "seconds"), [("ms", 1e-3), ("µs", 1e-6), ("us", 1e-6), ("ns", 1e-9), ("min", 60.0)]
    )
    def test_times_become_seconds(self, log, unit, seconds):
        found = quietly(log(f"time ({unit}),px\n0,1\n250,2\n500,3\n"))
        assert found.time.tolist() == pytest.approx([0, 250 * seconds, 500 * seconds], rel=1e-15)

    def test_a_strange_unit_is_named(self, log):
        with pytest.raises(ValueError, match=r"'px \(fathom\)', taken for px: unit 'fathom'"):
            navgym.read("csv", log("time,px (fathom)\n0,1\n1,2\n"))
        assert quietly(log("time,px,tide (fathom)\n0,1,1\n1,2,1\n")).measurements.shape == (2, 1)

    def test_a_row_of_units_counts(self, log):
        found = quietly(log("time,px,py\nms,km,m\n0,1,2\n100,3,4\n"))
        assert found.time.tolist() == [0, 0.1]
        assert found.measurements[:, 0].tolist() == [1000, 3000]


def stamped(cells):
    return "time,px\n" + "".join(f"{cell},{k}\n" for k, cell in enumerate(cells))


class TestTimes:
    @pytest.mark.parametrize(
        "cells",
        [
            ["2026-11-28T12:00:00Z", "2026-11-28T12:00:01Z", "2026-11-28T12:00:02.5Z"],
            ["2026-11-28 12:00:00", "2026-11-28 12:00:01", "2026-11-28 12:00:02.5"],
            ["2026/11/28 12:00:00", "2026/11/28 12:00:01", "2026/11/28 12:00:02.5"],
            ["2026-11-28T12:00:00+01:00", "2026-11-28T12:00:01+01:00", "2026-11-28T11:00:02.5Z"],
            ["28.11.2026 12:00:00", "28.11.2026 12:00:01", "28.11.2026 12:00:02.5"],
            ["12:00:00", "12:00:01", "12:00:02.500"],
            ["23:59:59", "00:00:00", "00:00:01.5"],
            ["1732788000", "1732788001", "1732788002.5"],
        ],
    )
    def test_dates_and_clocks_and_epochs_are_seconds(self, log, cells):
        time = quietly(log(stamped(cells))).time
        assert (time - time[0]).tolist() == [0, 1, 2.5]

    @pytest.mark.parametrize("unit", [1e3, 1e6, 1e9])
    def test_the_unit_of_dates_since_1970_is_plain_from_their_size_and_is_said(self, log, unit):
        cells = [round((1732788000 + s) * unit) for s in (0, 1, 2.5)]
        found = doubting(log(stamped(cells)), "since 1970: time_scale= or units=")
        assert found.time.tolist() == [0, 1, 2.5]
        assert found.meta["start"] == str(cells[0])
        told = quietly(log(stamped(cells)), time_scale=1 / unit)
        assert told.time.tolist() == [0, 1, 2.5]

    @given(
        start=st.integers(1_500_000_000_000_000_000, 1_900_000_000_000_000_000),
        steps=st.lists(st.integers(1, 10**9), min_size=1, max_size=20),
        places=st.sampled_from([0, 3, 6, 9]),
    )
    def test_stamps_since_1970_are_exact(self, tmp_path_factory, start, steps, places):
        """As whole ns, or as decimals of s, ms or us: differences to the last bit of a float."""
        stamps = list(itertools.accumulate(steps, initial=start))
        cells = [f"{s // 10**places}.{s % 10**places:0{places}}" if places else s for s in stamps]
        path = tmp_path_factory.mktemp("ns") / "log.csv"
        path.write_text(stamped(cells))
        found = quietly(path, time_scale=10.0 ** (places - 9))
        exact = np.array([s - start for s in stamps]) / 1e9
        assert np.abs(found.time - exact).max() <= 4 * np.spacing(exact.max())

    @given(st.lists(st.integers(1, 10**12), min_size=2, max_size=9, unique=True))
    def test_iso_dates_are_exact_to_a_nanosecond(self, tmp_path_factory, moments):
        start = np.datetime64("2026-11-28T23:59:59.5", "ns")
        stamps = start + np.sort(moments).astype("timedelta64[ns]")
        path = tmp_path_factory.mktemp("iso") / "log.csv"
        path.write_text(stamped([f"{s}Z" for s in stamps]))
        exact = (stamps - stamps[0]).astype(np.int64) / 1e9
        assert np.array_equal(quietly(path).time, exact)

    def test_a_date_and_a_clock_in_two_columns_are_one(self, log):
        text = "Date,Time,px\n2026-11-28,23:59:59,1\n2026-11-29,00:00:01,2\n"
        found = quietly(log(text))
        assert found.time.tolist() == [0, 2]
        assert found.meta["start"] == "2026-11-28T23:59:59.000000000Z"

    def test_a_midnight_is_said(self, log):
        assert "midnight 1 times" in said(quietly(log(stamped(["23:59:59", "00:00:00"]))))

    def test_milliseconds_are_not_taken_for_seconds_without_a_word(self, log):
        doubting(log(stamped(range(0, 3000, 100))), "the usual step is 100 s: if the times are ms")
        quietly(log(stamped(range(0, 3000, 100))), time_scale=1.0)
        quietly(log(stamped(range(0, 3000, 100))), units={"time": "s"})
        quietly(log(stamped(range(ROWS))))

    def test_velocities_tell_milliseconds_from_seconds(self, log):
        rows = [(100 * k, 0.2 * k, 2, 0.1 * k, 1) for k in range(40)]  # 100 ms at 2 and 1 m/s
        found = doubting(log(lines("time,px,vx,py,vy", rows)), "taken for ms, by what velocities")
        assert np.diff(found.time) == pytest.approx(0.1)
        slow = [(100 * k, 200 * k, 2, 100 * k, 1) for k in range(40)]
        assert quietly(log(lines("time,px,vx,py,vy", slow))).time[1] == 100

    @pytest.mark.parametrize(
        ("cells", "words"),
        [
            (["12:00:00", "noon"], "line 3, column 'time': must be a clock"),
            (["2026-11-28T12:00:00Z", "yesterday"], "line 3, column 'time': must be a date"),
            (["2026-11-28T12:00:00Z", "2026-13-28T12:00:00Z"], "line 3"),
            (["11/28/2026 12:00:00", "11/28/2026 12:00:01"], "line 2.*must be a date"),
            (["0", ""], "line 3, column 'time'"),
        ],
    )
    def test_what_is_no_time_is_named(self, log, cells, words):
        with pytest.raises(ValueError, match=words):
            navgym.read("csv", log(stamped(cells)))


class TestRows:
    def test_late_rows_are_sorted(self, log):
        found = quietly(log("time,px\n0,0\n2,2\n1,1\n3,3\n"))
        assert found.measurements[:, 0].tolist() == [0, 1, 2, 3]
        assert "sorted by time (1 times one came late, by up to 1 s)" in said(found)
        with pytest.raises(ValueError, match=r"line 4.*goes back by 1 s"):
            navgym.read("csv", log("time,px\n0,0\n2,2\n1,1\n3,3\n"), sort=False)

    @pytest.mark.parametrize("order", ["backwards", "shuffled"])
    def test_any_order_is_sorted(self, log, order):
        rows = list(range(40))[::-1] if order == "backwards" else RNG.permutation(40)
        found = quietly(log(lines("time,px", [(k, k) for k in rows])))
        assert found.measurements[:, 0].tolist() == list(range(40))

    def test_two_voyages_are_not_sorted_into_each_other(self, log):
        rows = [(k, k) for k in range(10)] + [(k + 0.5, -k) for k in range(10)]
        with pytest.raises(ValueError, match=r"line 12.*goes back by 8.5 s.*cut the file"):
            navgym.read("csv", log(lines("time,px", rows)))
        assert len(quietly(log(lines("time,px", rows)), sort=True)) == 20

    def test_a_clock_that_is_set_is_an_error(self, log):
        rows = [(k, k) for k in range(10)] + [(1732788000 + k, k) for k in range(10)]
        with pytest.raises(ValueError, match=r"line 12.*days. after the row before"):
            navgym.read("csv", log(lines("time,px", rows)))
        rows = [(k, k) for k in range(10)] + [(20000 + k, k) for k in range(10)]
        doubting(log(lines("time,px", rows)), "a gap of 5.55 h before line 12")

    def test_rows_that_repeat_each_other_are_one(self, log):
        found = quietly(log("time,px\n0,0\n1,1\n1,1\n2,2\n"))
        assert found.time.tolist() == [0, 1, 2]
        assert "1 times stand in rows that repeat each other" in said(found)

    def test_two_sensors_at_one_time_are_one_row(self, log):
        found = quietly(log("time,px,py,vx,vy\n0,1,2,,\n0,,,3,4\n1,5,,6,\n1,,7,,8\n"))
        assert found.measurements.tolist() == [[1, 3, 2, 4], [5, 6, 7, 8]]
        assert "2 times stand in several rows with different columns: merged" in said(found)

    def test_values_that_differ_at_one_time_are_averaged_aloud(self, log):
        found = doubting(log("time,px\n0,0\n1,1\n1,2\n2,2\n"), "first lines 3 and 4: their means")
        assert found.measurements[:, 0].tolist() == [0, 1.5, 2]

    def test_coarse_stamps_are_refused(self, log):
        rows = [(k // 10, 0.1 * k) for k in range(400)]
        with pytest.raises(ValueError, match="40 times stand in several rows"):
            navgym.read("csv", log(lines("time,px", rows)))

    def test_two_truths_at_one_time_are_refused(self, log):
        with pytest.raises(ValueError, match="line 3: another truth"):
            navgym.read("csv", log("time,px,truth_px,truth_py\n0,1,0,0\n0,1,1,1\n1,1,1,1\n"))

    @given(st.permutations(range(12)), st.integers(0, 11))
    def test_neither_order_nor_repeats_change_a_recording(self, tmp_path_factory, order, twice):
        path = tmp_path_factory.mktemp("rows") / "log.csv"
        path.write_text(lines("time,px", [(k, k * k) for k in (*order, order[twice])]))
        found = navgym.read("csv", path, sort=True)
        assert found.time.tolist() == list(range(12))
        assert found.measurements[:, 0].tolist() == [k * k for k in range(12)]


class TestLostValues:
    @pytest.mark.parametrize(
        "word",
        ["", "nan", "NaN", "-nan", "NA", "N/A", "null", "None", "-", "--", "inf", "-Infinity",
         "-nan(ind)", "1.#QNAN", "#N/A", "  "],
    )  # fmt: skip
    def test_usual_words_for_nothing(self, log, word):
        assert quietly(log(f"time,px,py\n0,1,2\n1,{word},3\n2,3,4\n")).lost.sum() == 1

    def test_words_and_numbers_of_the_users_own(self, log):
        path = log("time,px,py\n0,1,2\n1,lost,3\n2,3,-1.0\n")
        assert quietly(path, missing=["LOST", -1]).lost.sum() == 2
        assert quietly(path, missing=["lost", "-1"]).lost.sum() == 2

    @pytest.mark.parametrize("mark", [-9999, -999, 99999, "-9999.0"])
    def test_a_number_that_stands_for_nothing_is_said(self, log, mark):
        rows = [(k, mark if k == 3 else k, k) for k in range(9)]
        found = doubting(log(lines("time,px,py", rows)), "1 values of -?9+ are taken for lost")
        assert found.lost.sum() == 1

    def test_such_a_number_among_others_of_its_size_is_a_measurement(self, log):
        rows = [(k, -1002 + k, k) for k in range(9)]
        assert not quietly(log(lines("time,px,py", rows))).lost.any()


class TestHeldValues:
    """A receiver at 1 Hz in a log of 5 Hz repeats four of five fixes."""

    @staticmethod
    def receiver(digits, noise, share=5, rows=200, speed=1.0):
        rng = np.random.default_rng(3)
        fresh = np.arange(rows) // share * share
        p = speed * 0.2 * fresh[:, None] + noise * rng.normal(size=(rows, 2))[fresh]
        return [(f"{0.2 * k:.1f}", *(f"{x:.{digits}f}" for x in p[k]), k) for k in range(rows)]

    def test_a_held_fix_is_lost_and_said(self, log):
        text = lines("time,px,py,depth", self.receiver(3, 1.0))
        found = doubting(log(text), "80% of the rows with px and py repeat.*taken for held")
        assert (~found.lost).all(axis=1).nonzero()[0].tolist() == list(range(0, 200, 5))
        assert not quietly(log(text), held="keep").lost.any()

    def test_so_are_held_degrees(self, log):
        rows = [
            (t, 59 + float(x) * 1e-5, 18 + float(y) * 1e-5) for t, x, y, _ in self.receiver(3, 1)
        ]
        found = doubting(log(lines("time,lat,lon", rows)), "80% of the rows with lat and lon")
        assert found.lost.mean() == pytest.approx(0.8)

    def test_a_held_fix_beside_a_new_velocity(self, log):
        rng = np.random.default_rng(4)
        rows = [(*row[:3], *rng.normal(size=2).round(3)) for row in self.receiver(2, 0.5, share=2)]
        found = doubting(log(lines("time,px,py,vx,vy", rows)), "50% of the rows with px and py")
        assert found.lost.mean(axis=0).tolist() == [0.5, 0, 0.5, 0]

    @pytest.mark.parametrize(("digits", "noise"), [(0, 0.3), (1, 0.02), (2, 0.005)])
    def test_a_vehicle_at_rest_coarsely_rounded_is_measured(self, log, digits, noise):
        rows = self.receiver(digits, noise, share=1, speed=0.0)
        y = np.array([[float(cell) for cell in row[1:3]] for row in rows])
        assert repeats(y).mean() > 0.2
        assert not navgym.read("csv", log(lines("time,px,py", [r[:3] for r in rows]))).lost.any()

    def test_a_vehicle_at_rest_for_good_is_measured(self, log):
        assert not quietly(log(lines("time,px,py", [(k, 1.25, 2.5) for k in range(50)]))).lost.any()

    def test_coarse_but_regular_repeats_are_said(self, log):
        rows = [(k, k // 4, 0) for k in range(100)]
        found = doubting(log(lines("time,px,py", rows)), "kept, since their last digits are coarse")
        assert not found.lost.any()
        assert doubting(log(lines("time,px,py", rows)), "75%", held="lost").lost.mean() == 0.75

    def test_the_rule(self):
        """Changes of ten last digits decide; of three, where every value is repeated."""

        def judge(step, repeat):
            y = np.repeat(np.arange(40.0) * step, repeat)[:, None]
            return is_held(y, repeats(y), [1.0])

        assert judge(10, 2) is True
        assert judge(3, 2) is True
        assert judge(2, 2) is None
        assert judge(10, 1) is False

    def test_few_repeats_say_nothing(self, log):
        rows = [(k, f"{v:.1f}", 0) for k, v in enumerate([1, 0, 1, 0, 0, 2, 2])]
        assert not quietly(log(lines("time,px,py", rows))).lost.any()

    def test_zeros_that_every_cell_ends_in_are_no_digits(self, log):
        rows = [(k, f"{k // 4}.000", "0.000") for k in range(100)]
        doubting(log(lines("time,px,py", rows)), "kept, since their last digits are coarse")


class TestAccuracies:
    def test_the_receivers_own_deviations_are_r(self, log):
        text = "time,px,py,sd_n,sd_e\n0,1,2,1.5,2.5\n1,2,3,3,4\n2,3,4,,\n3,,,nan,0\n"
        model = quietly(log(text), position_noise=7).model
        assert np.array_equal(
            np.sqrt(np.diagonal(model.R, axis1=1, axis2=2)), [[1.5, 2.5], [3, 4], [7, 7], [7, 7]]
        )
        assert "2 measurements without an accuracy have the default noise" in said(
            quietly(log(text))
        )

    def test_one_accuracy_stands_for_both_axes_and_has_a_floor(self, log):
        text = "time,px,py,vx,vy,hAcc (mm)\n0,1,2,1,1,1500\n1,2,3,1,1,1\n"
        R = quietly(log(text), accuracy_floor=0.5).model.R
        assert R[:, 0, 0].tolist() == R[:, 2, 2].tolist() == [2.25, 0.25]
        assert R[:, 1, 1].tolist() == pytest.approx([0.01, 0.01])

    def test_filters_weigh_fixes_by_them(self, log):
        rows = [(k, 5 * (-1) ** k if k > 20 else 0.1 * k % 1, 0, 50 if k > 20 else 0.3)
                for k in range(40)]  # fmt: skip
        believed = navgym.estimate("kf", quietly(log(lines("time,px,py,sigma_position", rows))))
        assert np.abs(believed.states[21:, 0]).max() < 4.0

    def test_a_bad_first_fix_weighs_no_more_than_a_good_one(self, log):
        """x0 is made from it, at ten sigma: a hundredth of its own accuracy's weight."""
        rows = [(k, 0, 0, 30 if k == 0 else 1) for k in range(5)]
        found = quietly(log(lines("time,px,py,sigma_position", rows))).model
        assert found.P0[0, 0] >= 100 * 30**2
        plain = quietly(log(lines("time,px,py,sigma_position", [(*r[:3], 1) for r in rows]))).model
        np.testing.assert_allclose(found.P0, 900 * plain.P0)

    def test_a_model_of_the_users_own_gets_them_too(self, log):
        model = navgym.LinearModel(H=np.eye(4)[[0, 2]], R=4 * np.eye(2))
        found = quietly(log("time,px,py,sigma_px\n0,1,2,3\n1,2,3,\n"), model=model).model
        assert found.R[:, 0, 0].tolist() == [9, 4]
        assert found.R[:, 1, 1].tolist() == [4, 4]


class TestDegrees:
    """1e-5° of latitude are 1.11 m, of longitude 1.11 m times the cosine of the latitude."""

    @staticmethod
    def degrees(rows=40):
        return [(k, f"{59.3 + 1e-5 * k:.7f}", f"{18.1 + 2e-5 * k:.7f}", 5) for k in range(rows)]

    def test_degrees_become_metres_north_and_east(self, log):
        found = quietly(log(lines("time,Latitude,Longitude,alt", self.degrees())))
        assert found.meta["origin"] == [59.3, 18.1, 5.0]
        assert found.measurements[0].tolist() == [0, 0]
        # radii of curvature at 59.3° on WGS-84: 6 382 720 m along the meridian, 6 393 950 m across
        north = 39e-5 * np.pi / 180 * 6_382_720
        east = 78e-5 * np.pi / 180 * 6_393_950 * np.cos(np.radians(59.3))
        assert found.measurements[-1] == pytest.approx([north, east], rel=2e-5)

    @pytest.mark.parametrize(
        ("lat", "lon"),
        [
            ("59°18'N", "18°6'E"), ("59° 18.0' N", "18° 6.0' E"), ("59.3 N", "18.1 E"),
            ("59°18′00.0″", "18°06′00.0″"), ("59.3°", "18.1°"),
        ],
    )  # fmt: skip
    def test_degrees_and_minutes_are_text(self, log, lat, lon):
        found = quietly(log(f"time,lat,lon\n0,{lat},{lon}\n1,59.4,18.1\n"))
        assert found.meta["origin"][:2] == pytest.approx([59.3, 18.1], abs=1e-12)

    @pytest.mark.parametrize(
        ("unit", "lat", "lon"),
        [
            ("rad", np.radians(59.3), np.radians(18.1)), ("1e-7deg", 593000000, 181000000),
            ("ddmm.mmmm", "5918.0", "01806.0"),
        ],
    )  # fmt: skip
    def test_units_of_angles(self, log, unit, lat, lon):
        path = log(f"time,lat,lon\n0,{lat},{lon}\n1,{lat},{lon}\n")
        found = quietly(path, units={"lat": unit, "lon": unit})
        assert found.meta["origin"][:2] == pytest.approx([59.3, 18.1], abs=1e-9)

    def test_degrees_named_metres_are_refused_or_read_as_degrees(self, log):
        rows = lines("time,px,py", [row[:3] for row in self.degrees()])
        with pytest.raises(ValueError, match=r"look like degrees.*columns=\{'lat': 'px'"):
            navgym.read("csv", log(rows))
        assert np.ptp(quietly(log(rows), units={"px": "m", "py": "m"}).measurements) < 60
        named = log(rows.replace("px,py", "lat,lon"))
        found = doubting(named, "read as degrees", columns={"px": "lat", "py": "lon"})
        assert np.ptp(found.measurements[:, 0]) == pytest.approx(43.4, abs=0.1)

    def test_a_small_tank_in_metres_is_no_degrees(self, log):
        rows = [(k, f"{0.5 + 0.002 * k:.6f}", f"{0.3 + 0.001 * k:.6f}") for k in range(20)]
        assert np.ptp(quietly(log(lines("time,px,py", rows))).measurements[:, 0]) < 0.04

    def test_what_cannot_be_degrees_is_named(self, log):
        with pytest.raises(ValueError, match="line 3, column 'lat': must be within ±90°, got 5930"):
            navgym.read("csv", log("time,lat,lon\n0,59.3,18\n1,5930,18\n"))
        doubting(log("time,lat,lon\n0,1.03,.31\n1,1.04,.32\n"), "small enough to be radians")

    def test_a_receiver_without_a_fix_writes_zeros(self, log):
        found = quietly(log("time,lat,lon\n0,0.0,0.0\n1,59.3,18.1\n2,59.30001,18.1\n"))
        assert found.lost[:, 0].tolist() == [True, False, False]
        assert found.meta["origin"][:2] == [59.3, 18.1]

    @pytest.mark.parametrize("far", [10.0, 1e3, 1e5])
    @pytest.mark.parametrize("latitude", [0.0, 59.3, -80.0])
    def test_estimates_turn_back_into_the_degrees_that_they_came_from(self, log, far, latitude):
        size = far / 111e3
        rows = [
            (k, float(latitude + size * np.sin(k)), float(10 + size * np.cos(k))) for k in range(9)
        ]
        origin = (latitude, 10.0, 30.0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # 100 km is far, and is said
            found = navgym.read("csv", log(lines("time,lat,lon", rows)), origin=origin)
        states = np.zeros((9, 4))
        states[:, [0, 2]] = found.measurements
        for given_states in (states, found.measurements):
            lat, lon = navgym.geographic(found, given_states)
            assert lat == pytest.approx([float(row[1]) for row in rows], abs=1e-9)
            assert lon == pytest.approx([float(row[2]) for row in rows], abs=1e-9)

    def test_no_origin_no_degrees(self, log):
        with pytest.raises(ValueError, match="the recording has no origin"):
            navgym.geographic(quietly(log(PLAIN)), np.zeros((1, 4)))
        found = quietly(log(PLAIN), origin=(59.3, 18.1))
        assert navgym.geographic(found, np.zeros(4))[0] == pytest.approx(59.3)
        with pytest.raises(ValueError, match="states must hold 2 positions or 4 states"):
            navgym.geographic(found, np.zeros(3))

    def test_what_is_written_holds_both(self, log, tmp_path):
        found = quietly(log(lines("time,lat,lon", [row[:3] for row in self.degrees()])))
        text = write_csv(found, tmp_path / "back.csv").read_text().splitlines()
        assert text[0] == "time,px,py,lat,lon"
        assert [float(cell) for cell in text[-1].split(",")[3:]] == pytest.approx(
            [59.30039, 18.10078], abs=1e-10
        )
        again = quietly(tmp_path / "back.csv")
        assert np.array_equal(again.measurements, found.measurements)

    def test_truth_may_be_in_degrees(self, log):
        rows = [(k, lat, lon, lat, lon) for k, lat, lon, _ in self.degrees()]
        found = quietly(log(lines("time,lat,lon,truth_lat,truth_lon", rows)))
        assert found.truth[:, [0, 2]] == pytest.approx(found.measurements)
        assert found.truth[5, 1] == pytest.approx(1.114, abs=1e-2)


class TestDepth:
    def test_it_is_left_out_with_a_word_where_there_is_no_third_axis(self, log):
        found = quietly(log("time,px,py,Depth (m)\n0,1,2,3\n1,2,3,4\n"))
        assert "'Depth (m)' left out: the model has no third axis" in said(found)

    @pytest.mark.parametrize(
        ("name", "down"), [("pz", [3, 4]), ("depth [cm]", [0.03, 0.04]), ("altitude", [0, -1])]
    )
    def test_it_is_the_third_axis_of_a_model_that_has_one(self, log, name, down):
        F = np.kron(np.eye(3), [[1, 1], [0, 1]])
        model = navgym.LinearModel(
            F=F, H=np.eye(6)[[0, 2, 4]], Q=0.1 * np.eye(6), x0=np.zeros(6), P0=np.eye(6),
            position=(0, 2, 4), velocity=(1, 3, 5),
        )  # fmt: skip
        found = quietly(log(f"time,px,py,{name}\n0,1,2,3\n1,2,3,4\n"), model=model)
        assert found.measurements[:, 2].tolist() == pytest.approx(down)


class TestSensors:
    def test_a_late_velocity_goes_to_the_time_that_it_was_measured_at(self, log):
        rows = [(k, 10 * k, 100 + k) for k in range(4)]
        found = quietly(log(lines("time,px,vx", rows)), latency={"velocity": 0.25})
        nan = np.nan
        wanted = [[nan, 100], [0, nan], [nan, 101], [10, nan], [nan, 102], [20, nan]]
        np.testing.assert_array_equal(found.measurements[:6], wanted)
        assert found.time[:4].tolist() == [-0.25, 0, 0.75, 1]
        assert "velocity was measured 0.25 s before its stamps" in said(found)

    def test_a_latency_of_whole_steps_needs_no_more_rows(self, log):
        rows = [(f"{0.1 * k:.1f}", k, 100 + k, k, 0) for k in range(20)]
        found = quietly(log(lines("time,px,vx,py,vy", rows)), latency={"velocity": 0.5})
        assert len(found) == 25
        assert found.measurements[5, :2].tolist() == [0, 105]

    def test_truth_is_interpolated_at_the_new_times(self, log):
        rows = [(k, 2 * k, 1, 2 * k, 5) for k in range(5)]
        found = quietly(log(lines("time,px,vx,truth_px,truth_py", rows)), latency={"vx": 0.5})
        assert found.time[0] == 0
        assert found.truth[:, 0] == pytest.approx(2 * found.time)

    def test_a_fix_moves_from_the_antenna_to_the_vehicle(self, log):
        text = "time,px,py,heading\n0,10,20,0\n1,10,20,90\n2,10,20,\n"
        found = doubting(log(text), "1 positions are lost: no heading", lever_arm=(2, 1))
        # at 0° forward is north and right is east; at 90° east and south
        assert found.measurements[:2] == pytest.approx(np.array([[8, 19], [11, 18]]))
        assert found.lost[2].all()


class TestSizes:
    def test_a_bomb_is_refused(self, log):
        bomb = gzip.compress(b"0" * 30_000_000)
        with pytest.raises(ValueError, match=r"log.csv holds more than 1e.06 bytes.*largest="):
            navgym.read("csv", log(bomb), largest=1e6)

    @pytest.mark.parametrize("cut", [5, 30, 60])
    def test_a_truncated_or_damaged_gzip_file_is_named(self, log, cut):
        whole = gzip.compress(PLAIN.encode())
        with pytest.raises(ValueError, match=r"log.csv is a (truncated|damaged) gzip file"):
            navgym.read("csv", log(whole[:cut]))

    def test_a_line_without_an_end_is_refused(self, log):
        with pytest.raises(ValueError, match=r"log.csv, line 32: longer than 1000000 bytes"):
            navgym.read("csv", log(PLAIN + "1," * 2_000_000))

    def test_a_huge_cell_is_named_and_not_shown(self, log):
        with pytest.raises(ValueError, match=r"line 32, column 'px'.*500000 characters") as caught:
            navgym.read("csv", log(PLAIN + f"30,{'9' * 500_000},1,1,1\n"))
        assert len(str(caught.value)) < 300

    def test_a_hundred_thousand_rows_are_read_in_pieces(self, log):
        """Pieces of 65536 rows meet without a seam, lost cells and words among them."""
        count = 100_000
        rng = np.random.default_rng(1)
        values = np.cumsum(rng.normal(size=count)).round(4)
        cells = [("" if k % 7 == 0 else "NA" if k == 70_001 else repr(v.item()))
                 for k, v in enumerate(values)]  # fmt: skip
        found = quietly(log(lines("time,px", zip(range(count), cells, strict=True))))
        lost = (np.arange(count) % 7 == 0) | (np.arange(count) == 70_001)
        assert np.array_equal(found.lost[:, 0], lost)
        assert np.array_equal(found.measurements[~lost, 0], values[~lost])
        assert np.array_equal(found.time, np.arange(count))


def test_a_public_track_needs_no_option(akit):
    """Radians, brackets and NED velocities; the same metres as its own reader's, to a decimetre.

    That one takes the radii of curvature at the first sample, and leaves that sample out.
    """
    found = quietly(akit / "GT_trajectory1.csv")
    own = navgym.read("akit", akit, track=1)
    assert np.abs(found.measurements[1:] - own.truth)[:, [1, 3]].max() == 0
    assert np.abs(found.measurements[1:] - own.truth).max() < 0.1
    heading = quietly(akit / "GT_trajectory1.csv", lever_arm=(1.0, 0.0)).measurements
    moved = np.linalg.norm((heading - found.measurements)[:, [0, 2]], axis=1)
    assert moved == pytest.approx(1.0)
