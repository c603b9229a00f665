"""A thousand damaged files of each kind: each is read, or refused by an error that names it.

Where a kind guards its bytes with checksums, whatever is read of a damaged file stood in the good
one. Where it does not (sqlite3, ROS 1, most MCAP, dataflash, ULog, SBET), a number that is wrong and possible
cannot be told from a right one, and it is only asked that numbers are possible.
"""

import shutil
import time
import warnings

import numpy as np
import pytest

import navgym
from navgym.auv import device_log
from navgym.formats.channels import KINDS
from navgym.formats.kinds import read_channels
from navgym.formats.nmea import TELLERS
from tests import damage
from tests.formats.writers import START, WRITERS, Voyage, bag

LONGEST = 5.0  # s: a hang
DAY = 86_400 * 10**9  # ns
GUARDED = ("nmea", "nmea_vtg", "mcap_crc", "tlog", "pd0")
BAGS = ("mcap", "sqlite3", "ros1")  # which take longest, and hold their definitions too
SMALL = Voyage(count=12, start=START + 24 * 10**9)  # passes a midnight
FEW = Voyage(count=4)
MANY = 1000


def swapped(content, rng):
    """Two spans in each other's place."""
    a, b, c = sorted(rng.integers(0, len(content) + 1, 3).tolist())
    return content[:a] + content[b:c] + content[a:b] + content[c:]


def length(content, rng):
    """A word of four bytes that may be a length, large or none."""
    found = bytearray(content)
    at = int(rng.integers(0, max(len(found) - 4, 1)))
    found[at : at + 4] = int(rng.choice([0, 1, 255, 2**16, 2**31 - 1, 2**32 - 1])).to_bytes(
        4, "little"
    )
    return bytes(found)


DAMAGES = (*damage.BYTES, damage.flipped, damage.flipped, swapped, length, length)


def damaged(content, rng):
    for _ in range(rng.integers(1, 3)):
        content = DAMAGES[rng.integers(len(DAMAGES))](content, rng)
    return content


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("damaged")
    return {
        name: bag(folder / file, FEW, name, without=("/log/twist", "/odom", "/imu"))
        if name in BAGS
        else write(folder / file, SMALL)
        for name, (write, file) in WRITERS.items()
    }


def single(path):
    """The file with the data."""
    return path if path.is_file() else next(p for p in path.iterdir() if p.suffix != ".yaml")


def rows(channels):
    """Every row of a log as text, by channel."""
    return {
        (c.name, c.kind): {(t, *map(repr, v)) for t, v in zip(c.time.tolist(), c.values.tolist(), strict=True)}
        for c in channels.found
    }  # fmt: skip


def attempt(path):
    """The channels and the recording of a file, or what the error says."""
    found = []

    def heard(*args):
        found.append(read_channels(*args))
        return found[-1]

    try:
        with warnings.catch_warnings(), pytest.MonkeyPatch.context() as patch:
            warnings.simplefilter("ignore")
            patch.setattr(device_log, "read_channels", heard)  # to see what the reader saw
            log = navgym.read("log", path)
    except (ValueError, OSError) as error:
        return str(error)
    return found[0], log


def campaign(name, path, seeds, tmp_path):
    """How many of the damaged files were refused."""
    whole = single(path)
    content = whole.read_bytes()
    good = rows(read_channels(path))
    target = tmp_path / whole.name
    refused = 0
    for seed in seeds:
        target.write_bytes(damaged(content, np.random.default_rng([0xDC, seed])))
        begun = time.perf_counter()
        found = attempt(target)
        assert time.perf_counter() - begun < LONGEST, seed
        if isinstance(found, str):
            assert target.name in found, (seed, found)
            refused += 1
            continue
        channels, log = found
        assert np.isfinite(log.measurements[~log.lost]).all(), seed
        judge(name, good, channels, seed)
    return refused


def judge(name, good, found, seed):
    for channel in found.found:
        for values, most in zip(channel.values.T, KINDS[channel.kind].values(), strict=True):
            assert np.nanmax(np.abs(values), initial=0.0) <= most, seed
    if name not in GUARDED:
        return
    # of a file that has lost every date times count from midnight
    day = DAY if any("tells a date" in each for each in found.said) else 0
    if name.startswith("nmea"):  # where the first teller of a quantity is lost another counts
        good = {
            (told, kind): values for (_, kind), values in good.items() for told in TELLERS[kind]
        }
    for key, told in rows(found).items():
        right = {row[0] % day if day else row[0]: row for row in good.get(key, ())}
        for row in told:  # of an accuracy in a sentence of its own there may be none
            there = right.get(row[0] % day if day else row[0])
            assert there is not None, (seed, key, row)
            assert all(v in ("nan", r) for v, r in zip(row[1:], there[1:], strict=True)), (
                seed,
                key,
                row,
            )


@pytest.mark.parametrize("name", WRITERS)
def test_a_damaged_file_is_read_or_refused_by_name(name, logs, tmp_path):
    assert campaign(name, logs[name], range(25), tmp_path) > 1


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_a_thousand_damaged_files_are_read_or_refused_by_name(name, logs, tmp_path):
    refused = campaign(name, logs[name], range(MANY), tmp_path)
    print(f"{name}: {refused} of {MANY} refused")
    assert refused > MANY / 20


def test_a_bag_whose_metadata_are_damaged_is_read_or_refused_by_name(logs, tmp_path):
    folder = tmp_path / "bag"
    shutil.copytree(logs["sqlite3"], folder)
    content = (folder / "metadata.yaml").read_bytes()
    refused = 0
    for seed in range(60):
        (folder / "metadata.yaml").write_bytes(
            damage.damaged_text(content, np.random.default_rng([1, seed]))
        )
        found = attempt(folder)
        assert not isinstance(found, str) or "bag" in found, (seed, found)
        refused += isinstance(found, str)
    assert refused > 10
