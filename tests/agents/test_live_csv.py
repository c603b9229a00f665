"""A log line by line through `navgym stream`, and what that needs to be installed."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import navgym
from navgym.agents.live.lines import LONGEST_LINE, Format, Noise, estimates
from navgym.auv.csv_log import write_csv
from navgym.auv.environment import AUVDropoutEnv
from navgym.simulation import find_scenario
from tests.agents import hand_made
from tests.agents.both import AUV, DECK
from tests.agents.live import some_policy
from tests.commands import EXTRAS, without


def test_it_runs_without_torch():
    text = (
        "import sys, navgym.agents.live.lines\n"
        "from navgym import agents\n"
        "agents.SelfTuningFilter, agents.Policy\n"
        "heavy = {'torch', 'stable_baselines3', 'optuna', 'matplotlib'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", text], check=True)


class TestTheCommand:
    @staticmethod
    def start(policy, *words, **given):
        command = [sys.executable, "-m", "navgym.command", "stream", str(policy), *words]
        pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        return subprocess.Popen(command, **{"text": True} | pipes | given)

    @pytest.fixture(scope="class")
    @staticmethod
    def saved(tmp_path_factory):
        scenario = find_scenario("auv/switch-D")
        env = AUVDropoutEnv(scenario=scenario, overrides={"steps": 20}, action="residual")
        return some_policy(env, AUV).save(tmp_path_factory.mktemp("policies") / "some")

    def test_it_answers_each_line_before_the_next_one(self, saved):
        with self.start(saved) as process:
            process.stdin.write("time,px,py\n")
            for k in range(4):
                process.stdin.write(f"{k},{k},{2 * k}\n")
                process.stdin.flush()
                if k == 0:
                    assert process.stdout.readline().startswith("time,px,vx,py,vy,std_px")
                cells = process.stdout.readline().split(",")
                assert float(cells[0]) == k
                assert abs(float(cells[1]) - k) < 1.0
            process.stdin.close()
            assert process.wait() == 0

    def test_it_estimates_what_the_filter_does(self, saved, tmp_path):
        recording = navgym.simulate("auv/component-loss", seed=5, steps=60)
        path = write_csv(recording, tmp_path / "log.csv")
        with self.start(saved, "--velocity-noise", "1") as process:
            out, err = process.communicate(path.read_text())
        rows = np.genfromtxt(out.splitlines(), delimiter=",", names=True)
        assert process.returncode == 0
        assert rows["time"].tolist() == recording.time[-len(rows) :].tolist()
        assert ("waiting for a first position" in err) == (len(rows) < 60)
        miss = np.stack([rows["px"], rows["py"]], -1) - recording.truth[-len(rows) :, [0, 2]]
        assert np.sqrt((miss**2).sum(axis=1).mean()) < 2.0

    def test_the_shipped_policy_is_called_by_its_name(self):
        with self.start("auv") as process:
            out, _ = process.communicate("time,px,py\n1,1,1\n2,2,2\n")
        assert process.returncode == 0
        assert len(out.splitlines()) == 3

    def test_it_needs_what_a_plain_navgym_installs_and_nothing_else(self):
        code = without(EXTRAS) + "sys.exit(main(['stream', 'auv']))"
        text = "time,px,py\n1,1,1\n2,2,2\n"
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert len(done.stdout.splitlines()) == 3

    def test_words_that_other_commands_read_logs_by(self, saved):
        words = [
            "--read",
            "position_noise",
            "5",
            "columns.px",
            "n (m)",
            "columns.py",
            "e",
            "delimiter",
            ";",
        ]
        with self.start(saved, *words) as process:
            out, err = process.communicate("time;n (m);e\n1;1;1\n2;2;2\n")
        with self.start(saved, "--position-noise", "5") as process:
            wanted, _ = process.communicate("time,px,py\n1,1,1\n2,2,2\n")
        assert (process.returncode, err) == (0, "")
        assert out == wanted
        with self.start(saved, "--read", "largest", "5") as process:
            _, err = process.communicate("time,px,py\n")
        assert process.returncode == 2
        assert "option of format 'csv': 'largest'" in err

    def test_an_end_amid_a_line_broken_bytes_and_a_long_line_are_survived(self, saved):
        log = b"time,px,py\n1,1,1\n\xff\xfe\x00,\x80,1\n" + b"7" * 1_000_000 + b"\n2,2,2\n3,3,3"
        with self.start(saved, text=False) as process:
            out, err = process.communicate(log)
        assert process.returncode == 0
        assert [line.split(b",")[0] for line in out.splitlines()[1:]] == [b"1", b"2", b"3"]
        assert err.count(b"left out, line") == 2

    def test_a_full_disk_ends_it_with_one_line(self, saved):
        log = "\n".join(["time,px,py", *(f"{k},{k},{k}" for k in range(2000))])
        with Path("/dev/full").open("w") as full:
            process = self.start(saved, stdout=full)
            with process:
                _, err = process.communicate(log)
        assert process.returncode == 2
        assert [line for line in err.splitlines() if "time" not in line] == [
            "error: standard output cannot be written (No space left on device)."
        ]

    @pytest.mark.parametrize("where", ["/dev/full", "closed"])
    def test_nobody_to_hear_what_is_said_costs_no_estimate(self, saved, where):
        log = "time,px,py\n1,1,1\nx\n2,2,2\n"
        end, other = os.pipe()
        os.close(end)  # whoever read it is gone
        with Path("/dev/full").open("w") as full:
            target = full if where == "/dev/full" else other
            with self.start(saved, stderr=target) as process:
                out, _ = process.communicate(log)
        os.close(other)
        assert process.returncode == 0
        assert len(out.splitlines()) == 3

    def test_nobody_to_read_the_estimates_ends_it_without_a_word(self, saved):
        end, other = os.pipe()
        os.close(end)
        with self.start(saved, stdout=other) as process:
            _, err = process.communicate("time,px,py\n1,1,1\n2,2,2\n")
        os.close(other)
        assert err == ""

    def test_ctrl_c_ends_it_without_a_traceback(self, saved):
        with self.start(saved) as process:
            process.stdin.write("time,px,py\n1,1,1\n")
            process.stdin.flush()
            process.stdout.readline()
            process.stdout.readline()
            process.send_signal(signal.SIGINT)
            _, err = process.communicate()
        assert (process.returncode, err) == (130, "")

    def test_a_terminal_of_ascii_is_told_as_well(self, saved):
        env = os.environ | {"PYTHONIOENCODING": "ascii"}
        with self.start(saved, env=env) as process:
            out, err = process.communicate("time,px,py\n1,1,1\nü,1,1\n2,2,2\n")
        assert process.returncode == 0
        assert len(out.splitlines()) == 3
        assert "left out, line 3" in err
        with self.start("--help", env=env) as process:
            out, _ = process.communicate()
        assert process.returncode == 0
        assert "m/s" in out

    def test_bad_input_ends_it_with_a_message(self, saved):
        with self.start(saved) as process:
            out, err = process.communicate("a,b\n1,2\n")
        assert process.returncode == 2
        assert err.startswith("error: the first line must name the columns")
        assert not out


def _floats(line):
    return [float(cell) for cell in line.split(",")]


def run(policy, text):
    """Answers to the lines of a log, and what was said beside them."""
    return run_lines(policy, text.splitlines())


def run_lines(policy, lines):
    said = []
    return list(estimates(lines, policy, Noise(), said.append)), said


class TestLines:
    @pytest.fixture(scope="class")
    @staticmethod
    def policy():
        env = AUVDropoutEnv(overrides={"steps": 20}, action="residual")
        return some_policy(env, AUV)

    def test_lines_that_cannot_be_read_are_left_out(self, policy):
        log = "time,px,py\n1,1,1\n2,x,2\n2,2\n\n3,3,3\n3,9,9\n4,,4\n"
        answers, said = run(policy, log)
        assert [line.split(",")[0] for line in answers[1:]] == ["1", "3", "4"]
        wanted = ("line 3: column 'px'", "line 4: 2 cells", "line 7: time must increase")
        assert len(said) == 3
        assert all(text in line for text, line in zip(wanted, said, strict=True))

    def test_a_wrong_time_far_ahead_silences_nothing(self, policy):
        log = "time,px,py\n1,1,1\n2,2,2\n99999999,3,3\n4,4,4\n5,5,5\n"
        answers, said = run(policy, log)
        assert [line.split(",")[0] for line in answers[1:]] == ["1", "2", "4", "5"]
        assert len(said) == 1
        assert "time jumps from 2 to 99999999" in said[0]

    def test_a_long_gap_is_believed_when_the_next_line_confirms_it(self, policy):
        log = "time,px,py\n1,1,1\n2,2,2\n9001,3,3\n9002,4,4\n9003,5,5\n"
        answers, said = run(policy, log)
        assert [line.split(",")[0] for line in answers[1:]] == ["1", "2", "9002", "9003"]
        assert len([text for text in said if "left out" in text]) == 1

    def test_a_line_that_is_no_csv_is_left_out(self, policy):
        answers, said = run_lines(policy, ["time,px,py", "1,1,1", "2\r,1,1", "3,1,1"])
        assert [line.split(",")[0] for line in answers[1:]] == ["1", "3"]
        assert "is no line of a CSV file" in said[0]

    def test_a_tab_at_the_end_of_a_line_is_an_empty_cell(self, policy):
        said = []
        log = ["time\tpx\tpy\n", "1\t1\t1\n", "2\t2\t\r\n"]
        answers = list(estimates(log, policy, Noise(), said.append, Format("\t")))
        assert [line.split(",")[0] for line in answers[1:]] == ["1", "2"]
        assert not said

    def test_a_byte_order_mark_is_no_part_of_the_header(self, policy):
        answers, _ = run(policy, "\ufefftime,px,py\n1,1,1\n")
        assert len(answers) == 2

    def test_a_policy_of_another_filter_and_a_long_delimiter_are_refused_at_once(self, policy):
        deck = hand_made.policy(DECK, "deck/switch-60")
        with pytest.raises(ValueError, match="sets the parameters of idam"):
            run(deck, "time,px,py\n1,1,1\n")
        with pytest.raises(ValueError, match="delimiter must be one character"):
            Format("::")

    @pytest.mark.parametrize(
        ("header", "message"),
        [
            ("time,px,px", "same name"),
            ("time,lost", "must name the columns.*got time, lost.*--read columns.px"),
            ("px,py", "must name the columns"),
            ("time,north,n", "could each be px"),
            ("", "got nothing"),
        ],
    )
    def test_headers_without_meaning_are_refused(self, policy, header, message):
        with pytest.raises(ValueError, match=message):
            run(policy, header)

    def test_columns_of_no_meaning_are_said_once_and_not_looked_at(self, policy):
        answers, said = run(policy, "time,px,foo,py\n1,1,x,1\n2,2,y,2\n")
        assert answers == run(policy, "time,px,py\n1,1,1\n2,2,2\n")[0]
        assert said == ["columns of unknown meaning, not looked at: foo"]

    def test_names_and_units_are_those_of_the_reader(self, policy):
        wanted, _ = run(policy, "time,px,py\n1,1000,2000\n2,1001,2002\n")
        answers, said = run(policy, "Time [ms],North (km),East (km)\n1000,1,2\n2000,1.001,2.002\n")
        assert not said
        assert [r.split(",")[0] for r in answers[1:]] == ["1000", "2000"]
        for one, other in zip(answers[1:], wanted[1:], strict=True):
            np.testing.assert_allclose(_floats(one)[1:], _floats(other)[1:], rtol=1e-6, atol=1e-6)

    def test_latitude_and_longitude_come_back(self, policy):
        rows = [f"{k},{59 + k * 1e-5},{18 + k * 2e-5}" for k in range(30)]
        answers, _ = run(policy, "\n".join(["time,lat,lon", *rows]))
        assert answers[0].endswith(",fallback,lat,lon")
        cells = np.array([_floats(line) for line in answers[1:]])
        # a minute of latitude is a nautical mile, of longitude that times the cosine, to 1 %
        np.testing.assert_allclose(cells[-1, -2:], [59 + 29e-5, 18 + 58e-5], atol=1e-5)
        metres = 1852 * 60 * 29e-5 * np.array([1.0, 2.0 * np.cos(np.radians(59))])
        np.testing.assert_allclose(cells[-1, [1, 3]], metres, rtol=0.02)

    def test_a_line_without_end_is_left_out(self, policy):
        long = "9" * LONGEST_LINE
        answers, said = run_lines(policy, ["time,px,py", "1,1,1", long, "2,2,2"])
        assert len(answers) == 3
        assert len(said) == 1
        assert "line 3: it begins with '99999" in said[0]

    def test_two_sensors_of_one_time_both_count(self, policy):
        split, said = run(policy, "time,px,vx,py,vy\n1,1,,1,\n1,,3,,4\n2,4,,5,\n2,,3,,4\n")
        assert not said
        assert [line.split(",")[0] for line in split[1:]] == ["1", "1", "2", "2"]
        found = [_floats(line) for line in split[1:]]
        # the velocity is what the second line says, to its noise of .1
        np.testing.assert_allclose(np.array(found)[[1, 3]][:, [2, 4]], [[3, 4], [3, 4]], atol=0.1)
        twice, said = run(policy, "time,px,py\n1,1,1\n1,1,1\n2,2,2\n")
        assert len(twice) == 3
        assert "must increase, got 1 after 1" in said[0]

    def test_fall_backs_are_announced_once_and_so_is_their_end(self, policy):
        rng = np.random.default_rng(0)
        noise = np.where((np.arange(200) >= 60) & (np.arange(200) < 80), 30.0, 1.0)
        rows = [f"{k},{2 * k + noise[k] * rng.normal()},{k + rng.normal()}" for k in range(200)]
        answers, said = run(policy, "\n".join(["time,px,py", *rows]))
        fallen = [line.endswith(",1") for line in answers[1:]]
        changes = [k for k in range(1, 200) if fallen[k] != fallen[k - 1]]
        assert fallen[75]
        assert len(said) == len(changes)
        for k, line in zip(changes, said, strict=True):
            assert line.startswith(f"time {k}: ")
            assert ("fell back" in line) == fallen[k]
