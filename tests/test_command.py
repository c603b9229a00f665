"""The console command: one word, help that teaches, errors of one line."""

import re
import sys

import pytest

import navgym
from navgym import command
from navgym.core.data import VARIABLE, absent, data_folder
from tests.commands import EXTRAS, ROOT, ended, run, started, without


@pytest.fixture(scope="module")
def helps():
    """What `navgym COMMAND --help` says, by command."""
    processes = {name: started(_navgym(name, "--help")) for name in command.COMMANDS}
    found = {name: ended(process) for name, process in processes.items()}
    assert {code for code, _, _ in found.values()} == {0}
    return {name: out for name, (_, out, _) in found.items()}


def _navgym(*words):
    return [sys.executable, "-m", "navgym.command", *words]


@pytest.mark.parametrize("name", command.COMMANDS)
def test_help_teaches_by_examples(name, helps):
    assert helps[name].startswith(f"usage: navgym {name}")
    assert len(re.findall(rf"^ +navgym {name}\b|\| navgym {name}\b", helps[name], re.MULTILINE)) > 1
    # nothing that lies in a clone alone
    assert not re.findall(r"\b(?:docs|scripts|shared|tests)/\S*", helps[name])


def test_without_a_word_it_lists_what_there_is(capsys):
    assert command.main([]) == 0
    out = capsys.readouterr().out
    assert all(re.search(rf"^  {name} ", out, re.MULTILINE) for name in command.COMMANDS)


def test_it_knows_its_version(capsys):
    assert command.main(["--version"]) == 0
    assert capsys.readouterr().out == f"navgym {navgym.__version__}\n"


def test_it_is_installed_as_navgym(capsys, monkeypatch):
    (entry,) = [
        each
        for each in command.metadata.entry_points(group="console_scripts")
        if each.name == "navgym"
    ]
    monkeypatch.setattr(sys, "argv", ["navgym", "--version"])
    assert entry.load()() == 0
    assert capsys.readouterr().out.startswith("navgym ")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("tun",), "unknown command 'tun'. Did you mean 'tune'?"),
        (("warm", "auw"), "unknown problem 'auw'. Did you mean 'auv'?"),
        (("stream", "absent"), "absent.npz is missing"),
        (("demo", "--data", "nowhere"), "--data must be a folder of recordings: nowhere is none"),
        (("demo", "--trials", "-1"), "trials must be a whole number of at least 1, got -1"),
        (("headroom", "auv/switch-Z"), "unknown scenario 'auv/switch-Z'"),
        (("reproduce", "deck", "--trials", "3"), "--trials is for studies, and deck has none"),
        (
            ("benchmark", "auv", "--rounds", "0"),
            "rounds must be a whole number of at least 1, got 0",
        ),
        (("tune", "--config"), "--config needs a file"),
        (("tune", "--config", "absent.toml"), "absent.toml"),
        (("train", "absent.toml"), "absent.toml"),
        (("evaluate", "absent.npz"), "absent.npz"),
        (("combine", "--evaluate", "absent"), "absent.npz"),
    ],
)
def test_wrong_input_is_one_line_and_status_2(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert command.main(words) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert err.startswith("error: ")
    assert message in err


@pytest.mark.parametrize(
    "words", [("tune", "--filtre", "kf"), ("reproduce",), ("stream",), ("demo", "--seed", "x")]
)
def test_words_that_cannot_be_read_are_status_2(words, capsys):
    with pytest.raises(SystemExit) as stop:
        command.main(words)
    assert stop.value.code == 2
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "missing", "wanted"),
    [
        ("tune", ("tyro",), "this needs the package tyro: pip install 'navgym[tuning]'"),
        ("demo", ("optuna",), "the package optuna: pip install 'navgym[tuning]'"),
        ("train", ("tyro",), "the package tyro: pip install 'navgym[agents]'"),
        ("evaluate", ("tqdm",), "the package tqdm: pip install 'navgym[tuning]'"),
        ("combine", EXTRAS, "pip install 'navgym[agents]'"),
        # imported by the command only when it is needed
        (
            "train --decisions 1 --out {}",
            ("torch",),
            "the package torch: pip install 'navgym[agents]'",
        ),
        ("benchmark agents", ("torch",), "the package torch: pip install 'navgym[agents]'"),
        (
            "tune --sampler gp --trials 2 --out {}",
            ("torch",),
            "sampler 'gp' needs torch: pip install",
        ),
    ],
)
def test_a_missing_package_is_one_line_with_its_remedy(words, missing, wanted, tmp_path):
    words = words.format(tmp_path).split()
    code = f"{without(missing)}sys.exit(main({words!r}))"
    status, _, err = ended(started([sys.executable, "-c", code]))
    assert status == 2
    assert wanted in err.splitlines()[-1]  # a progress bar may stand before it
    assert "Traceback" not in err


def test_a_fault_of_our_own_is_not_hidden(monkeypatch):
    monkeypatch.setitem(command.COMMANDS, "tune", command.Command("navgym.nowhere:main", ""))
    with pytest.raises(ModuleNotFoundError):
        command.main(["tune"])


@pytest.mark.parametrize("name", command.COMMANDS)
def test_ctrl_c_is_status_130(name, monkeypatch, capsys):
    chosen = command.COMMANDS[name]
    here = command.Command(f"{__name__}:interrupted", chosen.what, chosen.extra, chosen.stopped)
    monkeypatch.setitem(command.COMMANDS, name, here)
    assert command.main([name]) == 130
    assert capsys.readouterr().err.strip() == chosen.stopped


def interrupted(words):
    """A command that is stopped at once."""
    raise KeyboardInterrupt


def test_one_problem_is_warmed_alone(capfd):
    assert command.main(["warm", "toy"]) == 0
    assert "kernels of toy ready" in capfd.readouterr().out


# ---- data


@pytest.fixture
def recordings(tmp_path, monkeypatch):
    """A folder with two data sets, which nothing points to."""
    monkeypatch.delenv(VARIABLE, raising=False)
    for name in ("akit", "repoimu"):
        (tmp_path / name).mkdir()
    return tmp_path


def test_data_is_the_set_s_folder_or_the_one_above(recordings):
    assert data_folder("akit", recordings) == recordings / "akit"
    assert data_folder("akit", recordings / "akit") == recordings / "akit"
    (recordings / "mine").mkdir()
    assert data_folder("akit", recordings / "mine") == recordings / "mine"


def test_another_set_is_not_taken_for_it(recordings):
    assert data_folder("multi_imu", recordings) is None
    assert data_folder("multi_imu", recordings / "repoimu") is None


def test_the_variable_names_the_folder_above_and_the_option_comes_first(recordings, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(recordings))
    assert data_folder("akit") == recordings / "akit"
    assert data_folder("multi_imu") is None
    assert data_folder("akit", recordings / "repoimu") is None


def test_nothing_is_looked_for_where_nobody_pointed(monkeypatch, tmp_path):
    monkeypatch.delenv(VARIABLE, raising=False)
    assert data_folder("akit") is None
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    assert data_folder("akit") is None
    monkeypatch.setenv(VARIABLE, str(tmp_path / "absent"))
    with pytest.raises(ValueError, match=r"NAVGYM_DATA must be a folder of recordings: .*absent"):
        data_folder("akit")
    assert "--data" in absent("A-KIT")
    assert VARIABLE in absent("A-KIT")


# ---- from a clone


SCRIPTS = {
    p.name: words[1]
    for p in sorted((ROOT / "scripts").glob("*.py"))
    if (words := re.search(r'main\(\["(\w+)", \*sys\.argv\[1:\]\]\)', p.read_text()))
}


def test_every_command_has_its_script():
    # a script called inspect.py would stand before Python's own module of that name
    alone = {"warm", "inspect", "export"}
    assert set(SCRIPTS.values()) == set(command.COMMANDS) - alone


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_is_its_command(name, helps):
    code, out, _ = ended(started([sys.executable, f"scripts/{name}", "--help"]))
    assert code == 0
    assert out == helps[SCRIPTS[name]]


def test_output_that_nobody_reads_any_more_ends_the_stream_quietly(tmp_path):
    lines = "time,px,py\n" + "".join(f"{k},{k},{k}\n" for k in range(1, 3000))
    (tmp_path / "log.csv").write_text(lines)
    shell = f"{sys.executable} -m navgym.command stream auv < {tmp_path / 'log.csv'} | head -n 2"
    status, out, err = ended(started(["bash", "-c", shell]))
    assert (status, len(out.splitlines())) == (0, 2)
    # what a stream says beside its estimates, such as that it falls back, but no error
    assert all(line.startswith("time ") for line in err.splitlines())


def test_the_same_words_are_recorded(tmp_path):
    words = ("--filter", "kf", "--scenario", "auv/mismatch", "--steps", "60", "--runs", "4")
    more = ("--select-runs", "4", "--report-runs", "4", "--trials", "4", "--workers", "1")
    code, _, err = run("tune", *words, *more, "--out", tmp_path)
    assert code == 0, err
    typed = command.as_typed("tune", [*words, *more, "--out", str(tmp_path)])
    assert f'command = "{typed}"' in (tmp_path / "tuned.toml").read_text()
