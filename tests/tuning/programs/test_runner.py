"""Programs as users have them: each ends in something to judge or in a failure with a name, and leaves
nothing behind.
"""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from navgym.tuning.programs.contract import Contract
from navgym.tuning.programs.runner import Command, Failed
from navgym.tuning.programs.tools import Log, Program, Runs
from tests.tuning.programs import making

GOOD = "printf 'time,nis\\n0,1\\n1,1.5\\n2,.5\\n' > $3"
ONE = {"parameters": {"q": {"range": [0.1, 10.0], "default": 1.0}}}


def tool(program, before="", **options):
    words = f"{before} {program} {{parameters}} {{log}} {{out}}".strip()
    return Program.of(Command.parsed(words, **options), Contract.of_dict(ONE))


@pytest.fixture
def log(tmp_path):
    return Log.of(making.write_log(tmp_path / "log.csv", 0, steps=20), 1)


def failure(program, log, **options):
    with pytest.raises(Failed) as raised:
        tool(program, **options).output(log, {"q": 1.0})
    return raised.value


def alive(mark):
    """Processes whose command line holds a mark."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            words = (place / "cmdline").read_bytes()
            state = (place / "stat").read_text().rsplit(")", 1)[1].split()[0]
        except OSError:
            continue
        if mark.encode() in words and state != "Z":
            found.append(int(place.name))
    return found


def gone(mark, patience=5.0):
    until = time.monotonic() + patience
    while alive(mark) and time.monotonic() < until:
        time.sleep(0.02)
    return not alive(mark)


def test_a_good_run_gives_its_columns(script, log):
    found = tool(script(GOOD)).output(log, {"q": 1.0})
    assert found.nis.tolist() == [1.0, 1.5, 0.5]
    assert found.kinds == ("nis",)


def test_the_program_is_told_every_digit(script, log):
    value = 1.2345678901234567
    text = 'printf "time,nis\\n0,1\\n1," > $3; sed -n "s/q = //p" $1 >> $3'
    assert tool(script(text)).output(log, {"q": value}).nis[1] == value


def test_nothing_that_a_shell_would_understand_is_understood(script, log):
    text = f'echo "$2" | grep -q "; touch" || exit 3; {GOOD}'
    strange = making.write_log(Path(log.what).with_name("a; touch b.csv"), 0, steps=20)
    assert tool(script(text)).output(Log.of(strange, 1), {"q": 1.0}).nis is not None
    assert not Path("b.csv").exists()


@pytest.mark.parametrize(
    ("text", "kind", "told"),
    [
        ("exit 7", "exit status 7", ""),
        ("echo no such sensor >&2; exit 1", "exit status 1", "no such sensor"),
        ("kill -SEGV $$", "killed by SIGSEGV", ""),
        ("true", "no output", "{out}"),
        (": > $3", "no output", ""),
        ("echo time,nis > $3", "no rows", ""),
        ("head -c 3000 /dev/urandom > $3", "garbage", ""),
        ("printf 'time,nis\\n0,1\\nhello,2\\n' > $3", "garbage", "line 3"),
        ("printf 'time,nis\\n0,1\\n1,1.5\\n2' > $3", "garbage", "line 4 of {out} has 1 cells"),
        ("printf '0,1\\n1,2\\n' > $3", "garbage", "must name columns"),
        ("printf 'time,nis\\n1,1\\n0,2\\n' > $3", "garbage", "must not go back"),
        ("printf 'time,colour\\n0,1\\n1,2\\n' > $3", "no such column", "neither"),
        ("printf 'time,innovation,variance\\n0,1,1\\n1,1,-2\\n' > $3", "not positive", ""),
    ],
)
def test_what_a_program_does_wrong_has_a_name(script, log, text, kind, told):
    found = failure(script(text), log)
    assert found.kind == kind
    assert told in found.text


def test_empty_cells_are_measurements_that_were_lost(script, log):
    text = "printf 'time,innovation,variance\\n0,1,1\\n1,,\\n2,nan,2\\n3,1,1\\n' > $3"
    found = tool(script(text)).output(log, {"q": 1.0})
    assert [str(v) for v in found.innovation[:, 0]] == ["1.0", "nan", "nan", "1.0"]


def test_a_program_that_hangs_is_killed_in_time(script, log):
    began = time.monotonic()
    found = failure(script("exec sleep 98761"), log, limit=0.3)
    assert found.kind == "time-out"
    assert time.monotonic() - began < 3.0
    assert gone("98761")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a subreaper")
def test_children_are_killed_with_a_program_that_hangs_and_after_one_that_ends(script, log):
    hung = "sleep 98762 & setsid sleep 98762 & (setsid sh -c 'sleep 98762; true' &) ; sleep 98762"
    assert failure(script(hung), log, limit=0.5).kind == "time-out"
    assert gone("98762")
    ended = f"setsid sleep 98763 & sleep 98763 & {GOOD}"
    assert tool(script(ended)).output(log, {"q": 1.0}).nis is not None
    assert gone("98763")


def test_a_program_that_fills_the_disk_is_stopped(script, log):
    one_file = failure(script("exec head -c 100000000 /dev/zero > $3"), log, largest=2**20)
    assert one_file.kind in ("too much output", "exit status 1")
    printed = failure(script("exec cat /dev/zero"), log, largest=2**20)
    assert printed.kind in ("too much output", "exit status 1")
    many = "i=0; while true; do head -c 500000 /dev/zero > part$i; i=$((i+1)); done"
    assert failure(script(many), log, largest=2**20, limit=20.0).kind == "too much output"


def test_runs_leave_no_file(script, log, tmp_path):
    where = tmp_path / "where"
    tool(script(f"pwd > {where}; touch rubbish; {GOOD}")).output(log, {"q": 1.0})
    assert not Path(where.read_text().strip()).exists()


def test_when_the_one_who_asks_is_killed_the_program_dies_and_its_folder_goes(
    script, log, tmp_path
):
    where = tmp_path / "where"
    path = script(f"pwd > {where}; setsid sleep 98764 & sleep 98764")
    source = (
        "from tests.tuning.programs.test_runner import tool\n"
        "from navgym.tuning.programs.tools import Log\n"
        f"tool({str(path)!r}).output(Log.of({log.what!r}, 1), {{'q': 1.0}})\n"
    )
    root = Path(__file__).resolve().parents[3]
    asker = subprocess.Popen([sys.executable, "-c", source], cwd=root)
    until = time.monotonic() + 30.0
    while time.monotonic() < until and not (where.exists() and len(alive("98764")) >= 2):
        time.sleep(0.02)
    assert alive("98764")
    asker.kill()
    asker.wait()
    assert gone("98764")
    scratch = Path(where.read_text().strip()).parent
    until = time.monotonic() + 5.0
    while scratch.exists() and time.monotonic() < until:
        time.sleep(0.02)
    assert not scratch.exists()


def test_a_guardian_that_was_killed_costs_one_run(script, log):
    path = script(
        f"[ -e {log.what}.once ] || {{ touch {log.what}.once; kill -9 $PPID; sleep 98765; }}; {GOOD}"
    )
    found = failure(path, log)
    assert found.kind == "lost"
    assert found.again
    assert tool(path).output(log, {"q": 1.0}).nis is not None
    if sys.platform.startswith("linux"):
        assert gone(str(path))
        assert gone("98765")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("./nowhere {parameters} {log} {out}", "there is no program './nowhere'"),
        ("sh -c 'x {parameters} {log}'", "must hold {out}"),
        ("sh run.sh {log} {out}", "must hold {parameters}"),
        ("sh run.sh {parameters} {log} {out} | tail", "only a shell understands"),
        ("sh run.sh {parameters} {log} > {out}", "only a shell understands"),
        ("sh 'run.sh {parameters} {log} {out}", "cannot be split"),
        ("", "must name a program"),
    ],
)  # fmt: skip
def test_a_command_that_cannot_be_is_refused_with_the_remedy(words, message):
    with pytest.raises(ValueError, match="(?s).*".join(["", *message.split("{")[:1]])) as raised:
        Command.parsed(words)
    assert message in str(raised.value)


def test_a_file_that_is_not_executable_is_said_to_be_so(script):
    path = script(GOOD)
    path.chmod(0o644)
    with pytest.raises(ValueError, match="chmod"):
        Command.parsed(f"{path} {{parameters}} {{log}} {{out}}")


def test_a_run_is_made_once_until_the_program_changes(script, log, tmp_path):
    count = tmp_path / "count"
    text = f"echo x >> {count}; {GOOD}"
    runs = Runs(tmp_path / "runs")

    def made(program):
        ruler = runs.ruler(program, log, {"q": 1.0})
        runs.of(program, log, {"q": 1.0}, ruler)
        return len(count.read_text().split())

    program = tool(script(text))
    assert made(program) == 1
    assert made(tool(script(text))) == 1
    assert made(tool(script(f"{text} # another"))) == 2


def test_a_kept_run_that_is_damaged_is_made_again(script, log, tmp_path):
    runs, program = Runs(tmp_path / "runs"), tool(script(GOOD))
    ruler = runs.ruler(program, log, {"q": 1.0})
    first = runs.of(program, log, {"q": 1.0}, ruler)
    for path in (tmp_path / "runs").rglob("*.json"):
        path.write_bytes(path.read_bytes()[:100])
    again = runs.of(program, log, {"q": 1.0}, ruler)
    assert again.sums["nis"].tolist() == first.sums["nis"].tolist()
