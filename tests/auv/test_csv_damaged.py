"""A thousand damaged logs: each is read, or refused by an error that names the file."""

import gzip
import warnings

import numpy as np
import pytest

import navgym
from tests import damage

SEEDS = range(1000)
COUNT = 24


def rows(names, columns, mark=","):
    cells = [mark.join(str(cell) for cell in row) for row in zip(*columns, strict=True)]
    return "\n".join([mark.join(names), *cells, ""])


def good_logs():
    """Contents of logs of every kind that has a path of its own through the reader."""
    rng = np.random.default_rng(5)
    x, y, u, v, s = rng.normal(size=(5, COUNT)).round(3)
    k = range(COUNT)
    dates = [f"2026-11-28T12:00:{i:02}.5Z" for i in k]
    lost = [int(i % 5 == 0) for i in k]
    truth = ("truth_px", "truth_py", "regime")
    return {
        "metres": rows(("time", "px", "vx", "py", "vy", "lost", *truth), (k, x, u, y, v, lost, x, y, lost)),
        "degrees": rows(
            ("Time (UTC)", "Latitude", "Longitude", "hAcc [m]", "alt"),
            (dates, 59.3 + 1e-4 * x, 18.1 + 1e-4 * y, abs(s), u),
        ),
        "commas": rows(("t [ms]", "North", "East"), (range(0, 2400, 100), x, y), ";").replace(".", ","),
        "clocks": "# hand made\n" + rows(
            ("Clock", "x", "y", "note"), ([f"23:59:{i + 30:02}" for i in k], x, y, ['"a, b"'] * COUNT)
        ).replace("Clock", "time"),
        "blanks": rows(("time", "vx", "vy"), ([f"{1732788000 + i}.25" for i in k], u, v), "  "),
        "stamps": rows(("time", "px", "py"), ([1732788000 * 10**9 + i for i in k], x, y), "\t"),
    }  # fmt: skip


@pytest.fixture(scope="module")
def logs():
    return {name: text.encode() for name, text in good_logs().items()}


def attempt(path, **options):
    """What the error says, None if the file is read; any other exception or warning comes through."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", UserWarning)
            navgym.read("csv", path, largest=1e7, **options)
    except (ValueError, OSError) as error:
        return str(error)
    return None


def test_the_logs_are_good_before_they_are_damaged(tmp_path, logs):
    for content in logs.values():
        path = tmp_path / "log.csv"
        path.write_bytes(content)
        assert attempt(path) is None


@pytest.mark.parametrize("packed", [False, True])
def test_a_damaged_log_is_read_or_refused_by_name(tmp_path, logs, packed):
    path, refused = tmp_path / "log.csv", 0
    seeds = SEEDS[::5] if packed else SEEDS
    for seed in seeds:
        rng = np.random.default_rng([0xDC, packed, seed])
        content = logs[list(logs)[rng.integers(len(logs))]]
        damaged = damage.damaged_text(gzip.compress(content) if packed else content, rng)
        path.write_bytes(damaged)
        said = attempt(path)
        refused += said is not None
        assert said is None or "log.csv" in said, (seed, said)
        assert said is None or len(said) < 2000, seed
    assert refused > len(seeds) / 4


@pytest.mark.parametrize(
    "content",
    [
        b'"' * 100_000,
        b'time,px\n0,"' + b'""' * 50_000,
        b"time,px\n" + b"," * 100_000 + b"\n",
        b"time,px\n" + b" " * 900_000 + b"1,2\n",
        b"time,px\n" + b"0,1\n" * 20 + b"9" * 900_000 + b",1\n",
        b"\n" * 1_000_000,
        b"#" * 900_000,
        b"time" + b",x" * 30_000 + b"\n",
        b"[" * 100_000,
        b"time,px\n" + b"1e308,1e308\n" + b"-1e308,-1e308\n" * 3,
        b"lat,lon,time\n" + b"1e300,1e300,1\n0,0,2\n",
        b"time,px,py\n" + b"0,1e308,1\n1,-1e308,2\n2,1e308,3\n",
        b"time,px\n5e-324,1\n1e-323,2\n",
        b"time,px\n" + b"9" * 30 + b",1\n" + b"9" * 31 + b",2\n",
        b"time,px,sigma_px\n0,1,1e200\n1,2,1e-200\n",
        b"time,px,truth_px,truth_py\n0,1,1e308,1\n1,2,-1e308,1\n",
        b"time,px\n2026-11-28T12:00:00Z,1\n9999-11-28T12:00:00Z,2\n",
        b"time,px\n0001-01-01T00:00:00Z,1\n0001-01-01T00:00:01Z,2\n",
        "time,px\n٠,١\n١,٢\n".encode(),
        "time,px\n0,½\n1,²\n".encode(),
    ],
    ids=range(20),
)
def test_a_file_made_to_harm_is_read_or_refused_by_name(tmp_path, content):
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    said = attempt(path)
    assert said is None or ("log.csv" in said and len(said) < 2000), said
