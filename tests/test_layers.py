"""Imports run one way: docs/design.md#rooms. Those within functions count, those for types don't.

Tables of names, such as `navgym.problem.REGISTERED` and what `lazy("module:name")` takes, are how
what is general finds what is not: they are strings, and nothing here sees them.
"""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
HOME = {"navgym": "navgym", "agents": "navgym.agents", "tuning": "navgym.tuning"}

PROBLEMS = {"auv", "deck", "ins"}
ABOVE = {"agents", "tuning"}
# everything that knows no problem: rooms, and the files in navgym/ itself
GENERAL = {
    "core", "envs", "formats", "identification", "inertial", "inspection", "metrics", "statespace",
    "", "command", "estimation", "exports", "inspect_command", "log_command", "mapping", "plotting", "plugins", "problem", "read_command", "readers", "samples", "simulation", "tuned", "warm",
}  # fmt: skip
EXCEPTIONS = {
    # a command per subject, and how fast agents are is measured by the agents
    ("navgym.tuning.commands.benchmark", "navgym.agents.benchmarks"),
}


def module_name(path):
    top, *rest = path.relative_to(ROOT).with_suffix("").parts
    return ".".join([HOME[top], *(part for part in rest if part != "__init__")])


MODULES = {module_name(p): p for top in HOME for p in (ROOT / top).rglob("*.py")}


def statements(node):
    """Every node below, but for what only a type checker runs."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            continue
        yield child
        yield from statements(child)


def imported(source):
    """Names of our modules that some source imports."""
    named = set()
    for node in statements(ast.parse(source)):
        if isinstance(node, ast.Import):
            named |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            inside = {f"{node.module}.{alias.name}" for alias in node.names}
            named |= {name if name in MODULES else node.module for name in inside}
    return named & set(MODULES)


# a module that is run imports itself by its own name
IMPORTS = {name: imported(path.read_text("utf-8")) - {name} for name, path in MODULES.items()}


def room(module):
    """First part of the name below navgym, "" for navgym itself."""
    return f"{module}.".split(".")[1]


def between(rooms, others):
    """Imports from modules of `rooms` into `others`, exceptions left out."""
    found = {(a, b) for a, names in IMPORTS.items() for b in names}
    return sorted(
        (a, b) for a, b in found - EXCEPTIONS if room(a) in rooms and room(b) in others - {room(a)}
    )


def test_every_module_is_in_a_room_that_is_known():
    assert {room(m) for m in MODULES} == GENERAL | PROBLEMS | ABOVE


def test_what_is_general_imports_no_problem_no_study_and_no_agent():
    assert not between(GENERAL, PROBLEMS | ABOVE)


def test_core_stands_on_nothing_and_inertial_on_core():
    assert not between({"core"}, GENERAL | PROBLEMS | ABOVE)
    assert not between({"inertial"}, (GENERAL | PROBLEMS | ABOVE) - {"core"})


@pytest.mark.parametrize("problem", sorted(PROBLEMS))
def test_a_problem_imports_no_other_and_nothing_above(problem):
    assert not between({problem}, PROBLEMS | ABOVE)


def test_studies_import_no_agents():
    assert not between({"tuning"}, {"agents"})


def test_exceptions_are_still_needed():
    assert all(b in IMPORTS[a] for a, b in EXCEPTIONS)


def test_nothing_imports_itself_in_a_circle():
    try:
        TopologicalSorter(IMPORTS).prepare()
    except CycleError as error:
        pytest.fail(f"a circle: {' <- '.join(error.args[1])}")


def test_the_toy_needs_no_other_problem():
    sources = [p.read_text("utf-8") for p in (ROOT / "tests" / "toy").glob("*.py")]
    rooms = {room(m) for source in sources for m in imported(source)}
    assert "problem" in rooms
    assert not rooms & PROBLEMS


def test_imports_are_found_wherever_they_stand():
    source = """
from typing import TYPE_CHECKING
import navgym.tuned
if TYPE_CHECKING:
    from navgym.deck.model import DeckModel
def late():
    from navgym.core import checks
    from navgym.core.seeds import seeds
"""
    assert imported(source) == {"navgym.tuned", "navgym.core.checks", "navgym.core.seeds"}
