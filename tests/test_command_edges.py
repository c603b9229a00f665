"""Every command at the edge: streams that are closed, full or ASCII, Ctrl-C while loading, forged files."""

import os
import resource
import signal
import subprocess
import sys

import pytest

from navgym import command
from tests.commands import ROOT

posix = pytest.mark.skipif(os.name != "posix", reason="descriptors and signals of POSIX")
SHELL = f'"{sys.executable}" -m navgym.command '


def shell(words, **env):
    """Exit status, output and errors of a line of bash; `navgym` is this one."""
    words = words.replace("navgym ", SHELL)
    found = subprocess.run(
        ["bash", "-o", "pipefail", "-c", words], env=os.environ | env, cwd=ROOT,
        capture_output=True, timeout=120, check=False,
    )  # fmt: skip
    assert b"Traceback" not in found.stderr, found.stderr.decode()
    assert b"Exception ignored" not in found.stderr, found.stderr.decode()
    return found.returncode, found.stdout, found.stderr.decode()


@posix
@pytest.mark.parametrize("name", ["", "tune", "stream"])  # by hand, by tyro, by argparse
def test_a_full_disk_behind_standard_output_is_one_line_and_status_2(name):
    status, _, err = shell(f"navgym {name} --help > /dev/full")
    assert status == 2
    assert err == "error: standard output cannot be written (No space left on device).\n"


@posix
@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ("navgym --version >&-", 0),
        ("navgym --version 2>&-", 0),
        ("navgym --version 2> /dev/full", 0),
        ("navgym --version <&- >&- 2>&-", 0),
        ("navgym warm auw 2> /dev/full", 2),
        ("navgym warm auw >&- 2>&-", 2),
        ("navgym train absent.toml 2> /dev/full", 2),
        ("navgym tune --filtre 2>&-", 2),
        ("navgym tune --filtre 2> /dev/full", 2),
        ("navgym stream auv <&-", 2),
        ("navgym --help | true", 141),
    ],
)
def test_streams_that_lead_nowhere_change_no_exit_status(words, wanted):
    status, _, err = shell(words)
    assert status == wanted, err


@posix
@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_no_file_takes_the_number_of_a_closed_stream(tmp_path, closed):
    # what is printed to descriptor 1 must not end up in a file that was opened later
    code = (
        "import os, sys; from navgym.core.streams import prepare; prepare()\n"
        "file = open(sys.argv[1], 'w'); print('lost'); sys.stderr.write('lost')\n"
        "assert file.fileno() > 2; os.write(1, b'lost'); os.write(2, b'lost'); file.write('kept')"
    )
    words = ["bash", "-c", f'"$0" -c "$1" "$2" {closed}', sys.executable, code, tmp_path / "a"]
    subprocess.run(words, check=True, capture_output=True)
    assert (tmp_path / "a").read_text() == "kept"


@pytest.mark.parametrize("name", command.COMMANDS)
def test_a_terminal_that_knows_ascii_alone_gets_every_line(name):
    status, out, err = shell(f"navgym {name} --help", PYTHONIOENCODING="ascii", LC_ALL="C")
    assert status == 0, err
    assert out.isascii()
    assert out.startswith(f"usage: navgym {name}".encode())
    assert err == ""


@pytest.mark.parametrize("name", ["tune", "stream"])
def test_an_error_is_said_in_ascii_where_nothing_else_is_known(name):
    status, _, err = shell(f"navgym {name} --ß 'ü§'", PYTHONIOENCODING="ascii", PYTHONUTF8="1")
    assert status == 2
    assert err.isascii()


INTERRUPT = """
import signal, sys
from importlib.machinery import PathFinder
found = PathFinder.find_spec
def find(name, path=None, target=None):
    if name == {module!r}:
        signal.raise_signal(signal.SIGINT)
    return found(name, path, target)
PathFinder.find_spec = find
sys.argv = ["navgym", {word!r}]
from navgym.command import main
sys.exit(main())
"""


@posix
@pytest.mark.parametrize(
    ("word", "module"),
    [
        ("tune", "gymnasium"), ("tune", "numpy"), ("tune", "navgym.problem"), ("tune", "optuna"),
        ("tune", "numba"), ("tune", "tyro"), ("train", "stable_baselines3"), ("stream", "numba"),
        ("evaluate", "navgym.agents.evaluation"), ("demo", "scipy"), ("warm", "navgym.warm"),
    ],
)  # fmt: skip
def test_ctrl_c_while_modules_are_loaded_is_one_line_and_status_130(word, module):
    code = INTERRUPT.format(word=word, module=module)
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert found.returncode in (130, -signal.SIGINT), found.stderr  # a shell sees 130 in both
    assert len(found.stderr.split("\n")) <= 3, found.stderr
    assert found.stderr.strip() in {"stopped", command.COMMANDS[word].stopped}


def test_a_program_of_ones_own_takes_ctrl_c_as_it_likes():
    code = "import sys, navgym; assert sys.excepthook is sys.__excepthook__"
    subprocess.run([sys.executable, "-c", code], check=True)


@posix
def test_warming_that_cannot_be_kept_says_so(tmp_path):
    code = "import sys, tests.toy; from navgym.command import main; sys.exit(main(['warm', 'toy']))"

    def full():
        resource.setrlimit(resource.RLIMIT_FSIZE, (400, 400))  # room for a semaphore

    found = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")},
        cwd=ROOT, preexec_fn=full, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert found.returncode == 0
    assert "kernels of toy compiled, but could not be kept, after" in found.stdout
    assert found.stderr.count("\n") == 1
    assert "cannot be kept in " in found.stderr


# ---- files


@pytest.mark.parametrize(
    "words",
    [
        ("tune", "--config", "deep.toml"),
        ("tune", "--config", "large.toml"),
        ("train", "deep.toml"),
        ("train", "large.toml"),
        ("combine", "--evaluate", "deep"),
        ("evaluate", "deep.npz"),
        ("evaluate", "large.npz"),
        ("stream", "deep"),
        ("tune", "--log", "/dev/null"),
        ("tune", "--out", "/dev/null"),
        ("train", "--out", "/dev/full"),
        ("evaluate", "--out", "/dev/null"),
        ("demo", "--out", "/dev/null"),
        ("headroom", "--out", "/dev/null"),
        ("reproduce", "deck", "--out", "/dev/null"),
    ],
)
def test_files_made_to_harm_are_one_line_and_status_2(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "deep.toml").write_text("a = " + "[" * 50_000)
    (tmp_path / "deep.json").write_text("[" * 50_000)
    (tmp_path / "deep.npz").write_bytes(b"PK\x05\x06" + bytes(18))
    (tmp_path / "large.npz").touch()
    for name in ("large.toml", "large.json"):
        with (tmp_path / name).open("wb") as file:
            file.truncate(300 * 10**6)
    try:
        status = command.main(words)
    except SystemExit as stop:
        status = stop.code
    err = capsys.readouterr().err
    assert status == 2, err
    assert "Traceback" not in err
    assert err.splitlines()[-1].startswith("error: "), err
