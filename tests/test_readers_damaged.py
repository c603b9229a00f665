"""A thousand damaged files per reader: each is read, or refused by an error that names it."""

import warnings

import numpy as np
import pytest

import navgym
from tests import damage
from tests.golden import rooms

SEEDS = range(1000)
ROWS = {"akit": 10, "deck_csv": 24, "repoimu": 60, "multi_imu": 26}
NAMES = {
    "akit": ("GT_trajectory1.csv", "DVL_trajectory1.csv"),
    "deck_csv": ("ship.csv",),
    "repoimu": (
        "Pendulum_Made_Trial1_Segment_1.csv", "Pendulum_Made_Trial1_Segment_2.csv",
    ),
    "multi_imu": ("path_1_IMU_1.csv", "path_1_IMU_2.csv"),
}  # fmt: skip
OPTIONS = {name: {**rooms.FORMATS[name][1]} for name in NAMES}
OPTIONS["multi_imu"] = {"delay": 0.0}  # too short to measure it


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """By format: the path to read, and its files' contents; a few dozen rows each."""
    found = {}
    for name, rows in ROWS.items():
        path = rooms.FORMATS[name][0](tmp_path_factory.mktemp(name))
        folder = path if path.is_dir() else path.parent
        for file in NAMES[name]:
            lines = (folder / file).read_text().splitlines()[:rows]
            (folder / file).write_text("\n".join(lines) + "\n")
        found[name] = path, {folder / file: (folder / file).read_bytes() for file in NAMES[name]}
    return found


def attempt(name, path, **options):
    """What the error says, None if the file is read after all."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of saturated sensors and the like
            navgym.read(name, path, **options)
    except (ValueError, OSError) as error:
        return str(error)
    return None


@pytest.mark.parametrize("name", NAMES)
def test_a_damaged_text_is_read_or_refused_by_name(name, good):
    path, files = good[name]
    assert attempt(name, path, **OPTIONS[name]) is None
    refused = 0
    for seed in SEEDS:
        rng = np.random.default_rng([0xDA, seed])
        file = list(files)[rng.integers(len(files))]
        file.write_bytes(damage.damaged_text(files[file], rng))
        said = attempt(name, path, **OPTIONS[name])
        file.write_bytes(files[file])
        refused += said is not None
        assert said is None or path.name in said or any(f.name in said for f in files), (seed, said)
    assert refused > len(SEEDS) / 3


@pytest.mark.parametrize("scenario", ["auv/switch-B", "auv/turn", "deck/paper"])
def test_a_damaged_recording_is_read_or_refused_by_name(scenario, tmp_path):
    short = {"duration": 1.0} if scenario.startswith("deck") else {"steps": 12}
    path = navgym.simulate(scenario, seed=1, **short).save(tmp_path / "mine.npz")
    content = path.read_bytes()
    assert attempt("npz", path) is None
    refused, seeds = 0, SEEDS[::3]  # of three kinds of models, a thousand in all
    for seed in seeds:
        path.write_bytes(damage.damaged_npz(content, np.random.default_rng([0xDB, seed])))
        said = attempt("npz", path)
        refused += said is not None
        assert said is None or "mine.npz" in said, (seed, said)
    assert refused > len(seeds) / 3
