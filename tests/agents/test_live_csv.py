"""A log line by line through `navgym stream`, and what that needs to be installed."""

import subprocess
import sys

import numpy as np
import pytest

import navgym
from navgym.agents.live.lines import Noise, estimates
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
    def start(policy, *words):
        command = [sys.executable, "-m", "navgym.command", "stream", str(policy), *words]
        pipe = subprocess.PIPE
        return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)

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
        assert err.count("waiting for a first position") == 60 - len(rows)
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

    def test_bad_input_ends_it_with_a_message(self, saved):
        with self.start(saved) as process:
            out, err = process.communicate("a,b\n1,2\n")
        assert process.returncode == 2
        assert err.startswith("error: the first line must name the columns")
        assert not out


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
        wanted = ("line 3, column 'px'", "line 4: 2 cells", "time must be finite and increase")
        assert len(said) == 3
        assert all(text in line for text, line in zip(wanted, said, strict=True))

    def test_a_wrong_time_far_ahead_silences_nothing(self, policy):
        log = "time,px,py\n1,1,1\n2,2,2\n99999999,3,3\n4,4,4\n5,5,5\n"
        answers, said = run(policy, log)
        assert [line.split(",")[0] for line in answers[1:]] == ["1", "2", "4", "5"]
        assert len(said) == 1
        assert "time jumps from 2 to 1e+08" in said[0]

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
        answers = list(estimates(log, policy, Noise(), said.append, "\t"))
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
            list(estimates([], policy, Noise(), print, "::"))

    @pytest.mark.parametrize(
        ("header", "message"),
        [
            ("time,px,foo", "unknown column 'foo'"),
            ("time,px,px", "same name"),
            ("time,lost", "no measurement column"),
            ("", "got nothing"),
        ],
    )
    def test_headers_without_meaning_are_refused(self, policy, header, message):
        with pytest.raises(ValueError, match=message):
            run(policy, header)

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
