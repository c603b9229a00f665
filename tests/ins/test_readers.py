"""Own logs as a folder of files, and A-KIT's tracks with their inertial data."""

import os
from pathlib import Path

import numpy as np
import pytest

import navgym
from navgym.ins.batch import InsBatch
from navgym.ins.catalogue import CATALOGUE
from navgym.ins.csv_set import read_ins_csv, write_ins_csv
from navgym.ins.estimation import run
from tests.ins.lanes import made

AKIT = Path(os.environ.get("NAVGYM_DATA", "nowhere")) / "akit"


class TestFolder:
    @pytest.fixture
    def folder(self, tmp_path):
        return write_ins_csv(made(seed=1, duration=20.0, fix_period=5.0), tmp_path / "log")

    def test_a_recording_comes_back(self, folder):
        given, found = made(seed=1, duration=20.0, fix_period=5.0), read_ins_csv(folder)
        np.testing.assert_allclose(found.angle, given.angle, atol=1e-12)
        np.testing.assert_allclose(found.time, given.time, atol=1e-9)
        assert set(found.aiding) == set(given.aiding)
        np.testing.assert_allclose(
            found.aiding["dvl"].values, given.aiding["dvl"].values, atol=1e-9
        )
        moved = found.aiding["fix"].values - given.aiding["fix"].values
        assert np.abs(moved - moved[0]).max() < 1e-3  # another origin
        assert np.isfinite(found.truth[:, :9]).all()
        assert navgym.read("ins_csv", folder).steps == given.steps

    def test_missing_imu_samples_become_gaps_and_silence_becomes_lost(self, folder):
        for name, rows in (("imu", slice(500, 520)), ("dvl", slice(8, 11))):
            lines = (folder / f"{name}.csv").read_text().splitlines(keepends=True)
            del lines[1:][rows], lines[rows.start + 1 : rows.stop + 1]
            (folder / f"{name}.csv").write_text("".join(lines))
        found = read_ins_csv(folder)
        assert found.gaps.sum() == 20
        assert found.aiding["dvl"].lost.sum() == 3
        assert any("did not come" in s for s in found.meta["reading"])

    def test_axes_units_and_clocks_are_turned_as_told(self, folder):
        plain = read_ins_csv(folder)
        turned = read_ins_csv(
            folder, turn={"gyro_y": "-gyro_y"}, time_offsets={"dvl": 0.25}, sensors={"dvl": {"noise": 0.5}}
        )  # fmt: skip
        np.testing.assert_array_equal(turned.angle[:, 1], -plain.angle[:, 1])
        assert turned.aiding["dvl"].time[0] == plain.aiding["dvl"].time[0] - 0.25
        assert turned.model.sensors["dvl"].noise.tolist() == [0.5] * 3
        with pytest.raises(ValueError, match="turn the axes"):
            read_ins_csv(folder, turn={"acc_z": "-acc_z"})
        with pytest.raises(ValueError, match="unknown sensor"):
            read_ins_csv(folder, time_offsets={"sonar": 1.0})
        with pytest.raises(FileNotFoundError, match=r"imu\.csv"):
            read_ins_csv(folder / "elsewhere")


@pytest.mark.skipif(not AKIT.is_dir(), reason="NAVGYM_DATA does not name A-KIT's data")
class TestAkit:
    @pytest.mark.parametrize(("track", "end"), [(2, 3.0), (6, 4.0)])
    def test_clocks_are_brought_together_and_the_filter_dead_reckons(self, track, end):
        r = navgym.read("akit_ins", AKIT, track=track)
        found = r.meta["alignment"]
        assert found["clock_rate"] == pytest.approx(399.0 / 400.0, abs=4e-4)
        assert found["lever_arm"][0] == pytest.approx(-1.84, abs=0.1)
        assert found["rate_rms"] < 1e-3
        batch = InsBatch.of([r])
        chosen = CATALOGUE["ins_kf"]
        states = run(chosen, batch, chosen.space.array()[None], 5, False).states[0]
        known = np.isfinite(r.truth[:, 0])
        e = states[known] - r.truth[known]
        assert np.hypot(e[-1, 0], e[-1, 1]) < end
        assert np.degrees(np.sqrt(np.mean(e[:, 8] ** 2))) < 0.5 or track == 6

    def test_a_track_that_is_not_there_is_said(self):
        with pytest.raises(FileNotFoundError, match="IMU_trajectory99"):
            navgym.read("akit_ins", AKIT, track=99)
