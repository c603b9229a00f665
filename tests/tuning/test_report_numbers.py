"""Whatever the numbers, a report is written: every table, figure and sentence on what studies can meet."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navgym.metrics.consistency import Consistency
from navgym.problem import PROBLEMS
from navgym.tuning.comparison import Comparison, Entry, rows_of
from navgym.tuning.objectives import find_measure
from navgym.tuning.report import plots, study_plots, tables, words
from navgym.tuning.study.run import Outcome, Trial
from navgym.tuning.study.sensitivity import Sweep

AUV = PROBLEMS["auv"]
LABELS = ("kf", "tuned", "oracle")
ANY = st.one_of(
    st.floats(-1e3, 1e3), st.sampled_from([0.0, -0.0, 1e-300, 1e300, math.nan, math.inf, -math.inf])
)
FEW = settings(max_examples=12, deadline=None)


@st.composite
def comparisons(draw, measures=("rmse", "fixes", "likelihood", "consistency")):
    """A comparison of three contenders on 1 to 9 recordings, whose losses are any numbers."""
    count = draw(st.integers(1, 9))
    measure = find_measure(AUV, draw(st.sampled_from(measures)))
    number = ANY if measure.parts[0].added else ANY.map(abs)
    errors = {
        label: np.array(draw(st.lists(number, min_size=count, max_size=count))) for label in LABELS
    }
    flags = {
        label: np.array(draw(st.lists(st.booleans(), min_size=count, max_size=count)))
        for label in LABELS
    }
    redrawn = {}
    if count < 8 and draw(st.booleans()):
        redrawn = {label: np.array(draw(st.lists(ANY, min_size=5, max_size=5))) for label in LABELS}
    entries = [Entry(label, "kf", bound=label == "oracle") for label in LABELS]
    rows = rows_of(entries, errors, flags, "kf", ("kf", "oracle"), measure, AUV, redrawn=redrawn)
    bands = [None, Consistency(9, draw(ANY), 0.9, 1.1, 0.5)]
    told = {label: draw(st.sampled_from(bands)) for label in LABELS}
    return Comparison(
        rows, "kf", {}, errors, dict.fromkeys(LABELS, 1.0), {}, measure,
        {label: {"nll": draw(ANY)} for label in LABELS},
        {"nll": find_measure(AUV, "likelihood").parts[0]}, told, told, redrawn,
    )  # fmt: skip


def texts(table):
    return [cell for row in table.rows for cell in row]


@FEW
@given(comparisons())
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numpy's, of numbers that are none
def test_a_comparison_of_any_numbers_is_shown_and_told(found):
    for ranked in (True, False):
        table = tables.ladder(found, ("tuned",), ranked=ranked)
        assert "nan" not in " ".join(texts(table))
        assert "-0.0 %" not in table.as_text()
    assert plots.ladder(found, ("tuned",), "").svg.startswith("<svg")
    tables.by_condition({"one": found, "two": found}, ("tuned",))
    plots.by_loss({"one": found}, LABELS, dict.fromkeys(LABELS, "#888888"), "")
    said = words.versus(found, "tuned", "kf") + words.nobody_better_than(found, "kf")
    assert "nan" not in said + words.best(found).label
    found.as_dict()


@FEW
@given(comparisons(measures=("likelihood",)))
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_likelihood_is_never_told_as_a_share(found):
    said = words.versus(found, "tuned", "kf")
    head = next(h for h in tables.ladder(found).head if h.startswith("gain"))
    assert head == "gain over kf, nats per component"
    assert "%" not in said.replace("95 % interval", "").replace("% of the runs", "")
    assert not any("%" in tables.gain(row) for row in found.rows)


@pytest.mark.parametrize("value", [-0.0004, 0.0, -1e-9])
def test_nothing_is_minus_nought(value):
    assert tables.share(value) == "+0.0 %"
    row = SimpleNamespace(
        diverges=False, gain=value, gain_low=value, gain_high=value, relative=True
    )
    assert tables.gain(row) == "+0.0 % [+0.0, +0.0]"


def outcome(results):
    space = AUV.find("kf").space
    rng = np.random.default_rng(0)
    drawn = [space.from_unit(u) for u in rng.random((len(results), len(space)))]
    pairs = enumerate(zip(drawn, results, strict=True))
    return Outcome(tuple(Trial(i, values, r, cost=1.0 + i) for i, (values, r) in pairs))


@FEW
@given(st.lists(ANY, min_size=1, max_size=12), ANY, st.booleans())
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_study_of_any_numbers_is_drawn(results, default, relative):
    made, space = outcome(results), AUV.find("kf").space
    assert plots.history(made, default, "").svg.startswith("<svg")
    study_plots.contour(made, space, space.names[:2], made.trials[0], "", relative)
    study_plots.front(made, made.trials[0], "m", "")
    change = np.resize(np.array(results), 5)
    values = np.geomspace(space.parameters[0].low, space.parameters[0].high, 5)
    sweep = Sweep(space.parameters[0], values[2], values, change, change, change, relative)
    study_plots.slices([sweep] * 2, made, "")
    study_plots.importance(dict.fromkeys(space.names, 0.0), [], "")


@FEW
@given(st.lists(ANY, min_size=1, max_size=30), st.booleans())
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_errors_over_time_of_any_numbers_are_drawn(series, squared):
    trace = np.array([series])
    time, colors = np.arange(float(len(series))), {"a": "#888888"}
    assert study_plots.over_time(time, {"a": trace}, colors, "m", "", squared).svg.startswith(
        "<svg"
    )


def test_every_figure_is_drawn_for_a_telephone_too():
    made = plots.history(outcome([3.0, 2.0, 1.0]), 2.5, "")
    widths = [float(svg.split('width="')[1].split("pt")[0]) for svg in (made.svg, made.narrow)]
    assert widths[1] <= 360.0 < widths[0]
