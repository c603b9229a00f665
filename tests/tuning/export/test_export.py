"""What is taken home is read by the target's own tool, to the digits that it can hold."""

import csv
import json
import shutil
import subprocess
import tomllib

import numpy as np
import pytest

from navgym.tuning.export.command import export, main

VALUES = {"EKF_ACC": 0.3512345678901234, "EKF_GPS": 1e-5, "EKF_GATE": 3, "EKF_BIG": 123456789.125}

PX4 = """# Onboard parameters for Vehicle 1
#
# Vehicle-Id Component-Id Name Value Type
1\t1\tEKF_ACC\t0.349999994039535522\t9
1\t1\tEKF_GATE\t5\t6
1\t1\tMPC_XY_P\t0.949999988079071045\t9
"""

ROBOT = """# our robot, tuned by hand
ekf_filter_node:
    ros__parameters:
        frequency: 30.0  # Hz
        two_d_mode: false
        process_noise_covariance: [0.05, 0.0, 0.0,
                                   0.0, 0.05, 0.0,
                                   0.0, 0.0, 0.06]
"""


@pytest.fixture
def tuned(tmp_path):
    def make(values, **more):
        import tomli_w

        told = {"filter": "mine", "parameters": values} | more
        told["provenance"] = {
            "command": "navgym tune --program x",
            "gain over defaults": {"held-out logs": "+3.1 %"},
        }
        path = tmp_path / "tuned.toml"
        path.write_text(tomli_w.dumps(told))
        return path

    return make


@pytest.mark.parametrize("present", [None, "EKF_ACC,0.35\nEKF_GATE 5\nMPC_XY_P\t0.95\n# end\n"])
def test_pymavlink_reads_what_ardupilot_is_told(tuned, tmp_path, present):
    mavparm = pytest.importorskip("pymavlink.mavparm")
    text, changes = export(tuned(VALUES), "ardupilot", present)
    path = tmp_path / "new.param"
    path.write_text(text)
    found = mavparm.MAVParmDict()
    assert found.load(str(path))
    for key, value in VALUES.items():
        assert np.float32(found[key]) == np.float32(value)
    assert len(found) == 4 + (present is not None)
    assert "# found by: navgym tune --program x" in text
    assert ("EKF_GATE: 5 -> 3" in [c.line for c in changes]) == (present is not None)
    assert ("EKF_ACC: 0.35 -> 0.351235" in text) == (present is not None)


@pytest.mark.parametrize("present", [None, PX4])
def test_five_columns_with_tabs_are_what_a_ground_station_reads(tuned, present):
    """As mavros' reader of QGroundControl's files does: comments by #, tabs, five columns, MAV_TYPE."""
    text, _ = export(tuned(VALUES), "px4", present)
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    rows = list(csv.reader(lines, delimiter="\t"))
    assert {len(row) for row in rows} == {5}
    kinds = {"6": int, "9": np.float32}
    found = {row[2]: kinds[row[4]](row[3]) for row in rows}
    for key, value in VALUES.items():
        assert found[key] == (value if isinstance(value, int) else np.float32(value))


def test_whole_numbers_and_real_ones_keep_their_type_in_px4(tuned):
    text, _ = export(tuned(VALUES), "px4", PX4)
    rows = {
        line.split("\t")[2]: line.split("\t")[3:] for line in text.splitlines() if line[0] != "#"
    }
    assert rows["EKF_GATE"] == ["3", "6"]
    assert rows["EKF_BIG"][1] == "9"
    assert rows["MPC_XY_P"] == ["0.949999988079071045", "9"]


def test_a_c_compiler_reads_the_header_to_the_last_bit(tuned, tmp_path):
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    values = VALUES | {"kind": "huber", "tiny": 5e-324}
    for before in (
        None,
        "#ifndef G\n#define G\n#define EKF_ACC 0.5 /* by hand */\nstatic const double tiny = 1.0;\n#endif\n",
    ):
        (tmp_path / "gains.h").write_text(export(tuned(values), "header", before)[0])
        names = [n for n in values if n != "kind"]
        source = "".join(f'printf("%a\\n", (double)({n}));' for n in names)
        (tmp_path / "show.c").write_text(
            f'#include <stdio.h>\n#include "gains.h"\n#include "gains.h"\nint main(void) {{ {source} puts(kind); return 0; }}\n'
        )
        subprocess.run(["cc", "-Wall", "-Werror", "-o", "show", "show.c"], cwd=tmp_path, check=True)
        shown = subprocess.run(
            [str(tmp_path / "show")], capture_output=True, text=True, check=True
        ).stdout.split()
        assert [float.fromhex(w) for w in shown[:-1]] == [float(values[n]) for n in names]
        assert shown[-1] == "huber"


@pytest.mark.parametrize("name", ["yaml", "robot_localization", "fuse"])
def test_yaml_is_read_back_to_the_last_bit_though_a_reader_is_strict(tuned, name):
    yaml = pytest.importorskip("yaml")
    found = yaml.safe_load(export(tuned(VALUES | {"kind": "no"}), name)[0])
    prefix = {"robot_localization": "ekf_filter_node", "fuse": "state_estimator"}
    if name in prefix:
        found = found[prefix[name]]["ros__parameters"]
    assert found == VALUES | {"kind": "no"}


def test_a_robots_file_keeps_its_comments_and_one_entry_of_its_covariance_changes(tuned):
    yaml = pytest.importorskip("yaml")
    path = tuned(
        {"q": 0.123456789012345678, "f": 50.0},
        targets={"q": "process_noise_covariance[1,1]", "f": "frequency"},
    )
    text, changes = export(path, "robot_localization", ROBOT)
    found = yaml.safe_load(text)["ekf_filter_node"]["ros__parameters"]
    assert found["process_noise_covariance"] == [0.05, 0, 0, 0, 0.123456789012345678, 0, 0, 0, 0.06]
    assert found["frequency"] == 50.0
    assert found["two_d_mode"] is False
    assert "# our robot, tuned by hand" in text
    assert "# Hz" in text
    assert [c.line for c in changes] == [
        "process_noise_covariance[1,1]: 0.05 -> 0.123457",
        "frequency: 30 -> 50",
    ]


def test_without_a_present_file_a_covariance_has_the_targets_size(tuned):
    yaml = pytest.importorskip("yaml")
    path = tuned({"q": 0.5}, targets={"q": "process_noise_covariance[6,6]"})
    found = yaml.safe_load(export(path, "robot_localization")[0])["ekf_filter_node"][
        "ros__parameters"
    ]
    assert len(found["process_noise_covariance"]) == 225
    assert found["process_noise_covariance"][6 * 15 + 6] == 0.5
    path = tuned({"q": 0.5}, targets={"q": "motion.process_noise_diagonal[3]"})
    found = yaml.safe_load(export(path, "fuse")[0])["state_estimator"]["ros__parameters"]
    assert found["motion"]["process_noise_diagonal"] == [0.0] * 3 + [0.5] + [0.0] * 11


def test_json_and_toml_are_read_back(tuned):
    assert json.loads(export(tuned(VALUES), "json", '{"a": {"EKF_ACC": 1}, "b": [1]}')[0]) == {
        "a": {"EKF_ACC": VALUES["EKF_ACC"]}, "b": [1], **{k: v for k, v in VALUES.items() if k != "EKF_ACC"},
    }  # fmt: skip
    text = export(tuned(VALUES), "toml", "x = 1\n[a]\nEKF_GATE = 9\n")[0]
    assert tomllib.loads(text)["a"]["EKF_GATE"] == 3
    assert text.startswith("# Written by navgym export")


@pytest.mark.parametrize(
    ("values", "name", "message"),
    [
        ({"accel noise": 1.0}, "px4", "16 capital letters.*--name accel noise TARGET"),
        ({"A": 1e300}, "px4", "cannot be held"),
        ({"A": "huber"}, "ardupilot", "holds numbers only"),
        ({"a.b": 1.0}, "header", "identifier of C"),
        ({"A": 1.0}, "px5", "Did you mean 'px4'"),
        ({}, "px4", "holds no tuned parameters"),
    ],
)
def test_what_a_format_cannot_hold_is_refused_with_the_remedy(tuned, values, name, message):
    with pytest.raises(ValueError, match=message):
        export(tuned(values), name)


@pytest.mark.parametrize(
    ("name", "present", "target", "message"),
    [
        ("yaml", "a: [1", "a", "no file of format"),
        ("yaml", "- 1", "a", "no table"),
        ("json", "{", "a", "no file of format"),
        ("toml", "x =", "a", "no file of format"),
        ("yaml", "a: [1, 2]", "a[5]", "no such entry"),
        ("yaml", "a: [1, 2]", "a", "is a list"),
        ("yaml", "x: {a: 1}\ny: {a: 2}", "a", "several tables hold 'a'"),
        ("yaml", "a: 1", "a.b", "leads into a"),
    ],
)
def test_a_present_file_that_does_not_fit_is_refused(tuned, name, present, target, message):
    with pytest.raises(ValueError, match=message):
        export(tuned({"q": 0.5}, targets={"q": target}), name, present)


def test_the_command_writes_the_file_and_says_what_changes(tuned, tmp_path, capsys):
    (tmp_path / "old.params").write_text(PX4)
    out = tmp_path / "new.params"
    path = tuned({"accel": 0.5}, units={"accel": "m/s^2"})
    assert (
        main(
            [
                str(path),
                "--present",
                str(tmp_path / "old.params"),
                "--out",
                str(out),
                "--name",
                "accel",
                "EKF_ACC",
            ]
        )
        == 0
    )
    assert "EKF_ACC: 0.35 -> 0.5 m/s^2" in capsys.readouterr().out
    assert "1\t1\tEKF_ACC\t0.5\t9\n" in out.read_text()


def test_a_filter_of_ours_is_taken_home_too(tmp_path, capsys):
    path = tmp_path / "tuned.toml"
    path.write_text(
        'filter = "qivbf"\n[parameters]\nprocess_noise_scale = 10.0\nforgetting = 0.95\n'
    )
    assert main([str(path), "--as", "header"]) == 0
    assert "#define forgetting 0.95" in capsys.readouterr().out
