"""What tests of command lines share: a process of `navgym`, and one in which packages are missing."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# what no plain `pip install navgym` brings
EXTRAS = (
    "tyro", "optuna", "cmaes", "tqdm", "matplotlib", "jinja2", "tomli_w", "sklearn",
    "torch", "stable_baselines3", "tensorboard", "distributed", "psycopg",
)  # fmt: skip


def start(*words, folder=ROOT):
    """A running `navgym`."""
    command = [sys.executable, "-m", "navgym.command", *map(str, words)]
    return started(command, folder)


def started(command, folder=ROOT):
    """Any running command, in wide lines."""
    pipe, wide = subprocess.PIPE, os.environ | {"COLUMNS": "200"}
    return subprocess.Popen(command, cwd=folder, text=True, stdout=pipe, stderr=pipe, env=wide)


def run(*words, folder=ROOT):
    """Exit status, output and errors of `navgym`."""
    return ended(start(*words, folder=folder))


def ended(process):
    """Exit status, output and errors of a command."""
    out, err = process.communicate()
    return process.returncode, out, err


def without(packages):
    """Source that makes an interpreter in which `packages` are not installed; `main` is navgym's."""
    return (
        "import sys\n"
        "from importlib.machinery import PathFinder\n"
        "found = PathFinder.find_spec\n"
        "def find(name, path=None, target=None):\n"
        f"    gone = name.partition('.')[0] in {tuple(packages)!r}\n"
        "    return None if gone else found(name, path, target)\n"
        "PathFinder.find_spec = find\n"
        "from navgym.command import main\n"
    )
