"""The demo, the reproduction and the maintainers' scripts as a user runs them."""

import json
import re
import signal
import sys
import time

import pytest

from navgym.core.seeds import split_of
from tests.browser import check, needs_browser
from tests.commands import ROOT, ended, run, start, started

# what is no command of navgym, because it is for those who work on it
OWN = sorted(
    p.name for p in (ROOT / "scripts").glob("*.py") if "navgym.command" not in p.read_text()
)


@pytest.mark.parametrize("name", OWN)
def test_help_teaches(name):
    code, out, _ = ended(started([sys.executable, f"scripts/{name}", "--help"]))
    assert code == 0
    assert f"python scripts/{name}" in out  # shows how it is called
    assert len(out.splitlines()) > 7


# ---- the demo


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """A quick demo: its output, page and results."""
    out = tmp_path_factory.mktemp("demo")
    code, text, err = run("demo", "--quick", "--trials", 16, "--runs", 30, "--out", out)
    assert code == 0, err
    return (
        out,
        text,
        (out / "report.html").read_text(),
        json.loads((out / "results.json").read_text()),
    )


def test_the_demo_prints_its_table_and_where_the_page_is(demo):
    out, text, _, results = demo
    for row in results["conditions"]["switch-D, 30 % lost"]["rows"]:
        assert re.search(rf"^{re.escape(row['label'])} ", text, re.MULTILINE)
    assert f"report: {out / 'report.html'}" in text
    assert re.search(r"position, to 1 m, and its velocity, to 1 m/s", text)
    assert text.splitlines()[-2].startswith("now your log")
    assert text.splitlines()[-1].strip().startswith("navgym inspect my.csv")


@needs_browser
def test_the_page_fits_in_a_browser(demo, tmp_path):
    check([demo[0] / "report.html"], tmp_path)


def test_the_page_shows_the_numbers_of_the_results(demo):
    _, _, html, results = demo
    shown = [results["conditions"].values(), results["tracks"]["comparisons"].values()]
    for comparison in [c for group in shown for c in group]:
        for row in comparison["rows"]:
            if row["divergence_rate"] <= 0.01:
                assert f"{row['mean']:.3f} ± {row['high'] - row['mean']:.3f}" in html, row["label"]
    for value in results["tuning"]["chosen"]["values"].values():
        assert f"{value:.4g}" in html
    assert html.count("<svg") >= 6
    assert "Do not quote these numbers" in html  # it was shortened
    assert not re.search(r"(src|href)=", html.replace("xlink:href=", ""))
    assert str(ROOT) not in html


def test_the_page_says_that_filters_which_learn_nothing_are_ahead(demo):
    _, _, html, results = demo
    rows = {row["label"]: row for row in results["conditions"]["switch-D, 30 % lost"]["rows"]}
    assert rows["bank"]["mean"] < rows["imm"]["mean"] < rows["qivbf, tuned"]["mean"]
    assert "though nothing in them was tuned or learnt" in html
    assert "Nothing beats <code>kf</code> there" in html


def test_nothing_is_reported_on_what_was_tuned_on(demo):
    *_, results = demo
    tuned_on = results["tuning"]["goal"]["recordings"]["seeds"]
    assert {split_of(seed) for seed in tuned_on} == {"train"}
    reported = [*results["conditions"].values(), *results["tracks"]["comparisons"].values()]
    for comparison in [*reported, results["coordinated turn"]]:
        assert {split_of(seed) for seed in comparison["recordings"]["seeds"]} == {"test"}
    tracks = set(range(1, 7))
    for halves in results["tracks"]["tuned on the other tracks"].values():
        assert set(halves[0]["tracks"]) | set(halves[1]["tracks"]) == tracks


def test_results_say_what_they_rest_on(demo):
    *_, results = demo
    basis = results["provenance"]
    assert basis["command"].startswith("navgym demo --quick")
    assert {"navgym", "python", "numpy", "optuna"} <= set(basis["versions"])
    assert basis["seeds"]["all figures"] == "test"


def test_the_same_command_again_finds_the_study_done_and_the_same_numbers(demo):
    out, _, _, results = demo
    code, _, err = run("demo", "--quick", "--trials", 16, "--runs", 30, "--out", out)
    assert code == 0, err
    again = json.loads((out / "results.json").read_text())
    for run_ in (again, results):
        run_.pop("microseconds per filter step", None)
    assert again == results


def test_ctrl_c_ends_with_what_was_found(tmp_path):
    process = start("demo", "--quick", "--trials", 5000, "--out", tmp_path)
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and process.poll() is None:
        journal = next(tmp_path.glob("*.log"), None)
        if journal is not None and journal.read_bytes().count(b"\n") > 60:
            break
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130, err
    assert re.search(r"stopped after \d+ trials: the best so far has", out)
    assert "the same command goes on" in out
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("--data", "nowhere", "--quick"),
            "--data must be a folder of recordings: nowhere is none",
        ),
        (("--data", "tests", "--quick", "--trials", 1), "tests holds no GT_trajectory"),
        (("--quick", "--trials", -1), "trials must be a whole number of at least 1, got -1"),
    ],
)
def test_bad_input_is_one_line(tmp_path, arguments, message):
    code, _, err = run("demo", *arguments, "--out", tmp_path)
    assert code == 2
    assert message in err
    assert "Traceback" not in err


@pytest.mark.slow
@pytest.mark.parametrize("half", ["auv", "deck"])
def test_the_reproduction_runs_end_to_end(half, tmp_path):
    code, out, err = run("reproduce", half, "--quick", "--out", tmp_path)
    assert code == 0, err
    results = json.loads((tmp_path / f"{half}.json").read_text())
    html = (tmp_path / f"{half}.html").read_text()
    for title, part in results["parts"].items():
        assert title in html
        assert title in out
        assert part["checks"]
