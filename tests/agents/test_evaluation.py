"""The evaluator is paired, repeatable, complete, and flatters nobody."""

import json
import math
import re
import shutil

import numpy as np
import pytest

pytest.importorskip("tyro")


from navgym.agents.combiner.combiner import Combiner
from navgym.agents.evaluation import report as evaluation_report
from navgym.agents.evaluation import tables as evaluation_tables
from navgym.agents.evaluation import verdicts as evaluation
from navgym.agents.evaluation.contest import BEST_FIXED, OWN, SHIFT, Condition, Extent
from navgym.agents.evaluation.league import League
from navgym.agents.evaluation.play import joined, parts, play
from navgym.agents.evaluation.rollout import Learnt, roll_out
from navgym.agents.evaluation.streamed import stream
from navgym.agents.evaluation.verdicts import (
    Bench,
    beaten,
    evaluate,
    failures,
    leagues,
    load,
    load_combiners,
    own_conditions,
)
from navgym.agents.policies.policy import Policy
from navgym.auv.scenarios import SHIFTS
from navgym.command import main as command
from navgym.core.data import VARIABLE
from navgym.core.seeds import split_of
from navgym.problem import problem_of
from navgym.simulation import simulate_many
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters.combiner import UNITS, shapes
from navgym.statespace.filters.modes import MODE_SETS
from navgym.tuning.comparison import Comparison, Entry, rows_of
from navgym.tuning.report import page as report
from tests.agents import hand_made
from tests.agents.both import AUV, DECK, run
from tests.agents.mixtures import mixture
from tests.browser import check, needs_browser

# a vehicle that manoeuvres all the time, which the best fixed parameters of `nominal` know nothing of
WRONG_MODEL = {"process_scale": 20.0, "steps": 150, "loss": 0.0}
SMALL = Extent(quick=True, runs=8, draws=1)
A6 = (
    "default", "hand rule", "best fixed", "true-regime table", "imm", "imm_wide", "bank", "bank_2026", "oracle",
)  # fmt: skip


def steady(scenario="auv/nominal", bias=0.0, overrides=WRONG_MODEL, **options):
    """A policy that always takes the same action on q."""
    return hand_made.policy(
        AUV, scenario, {(0, "bias"): bias}, overrides=overrides, action_parameters=("process_noise_scale",), **options
    )  # fmt: skip


def good():
    return steady(bias=0.65)  # of half the range of log q, above 1: about 20


def idle():
    return steady()


def benches(policies, **options):
    return evaluate(leagues(policies, SMALL, fallback=False, **options), progress=False)


@pytest.fixture(scope="module")
def bench():
    (found,) = benches({"good": good(), "idle": idle()})
    return found


# ---- verdicts


def test_a_policy_that_knows_the_motion_beats_parameters_that_do_not(bench):
    verdict = next(v for v in bench.verdicts if v.policy == "good")
    assert verdict.better
    assert 0.0 < verdict.low < verdict.gain < verdict.high < 1.0
    assert verdict.score > 0.5


def test_an_interval_that_touches_zero_is_not_better(bench):
    verdict = next(v for v in bench.verdicts if v.policy == "idle")
    # the idle policy is the best fixed parameters: every difference is exactly 0
    np.testing.assert_array_equal(
        *(bench.find(verdict.condition).main.errors[k] for k in ("idle", BEST_FIXED))
    )
    assert (verdict.gain, verdict.low, verdict.high) == (0.0, 0.0, 0.0)
    assert not verdict.better
    assert [s for s in failures([bench]) if s.startswith("idle is not better")]
    assert not [s for s in failures([bench]) if s.startswith("good")]


def test_a_policy_answers_for_every_scenario_that_is_named():
    """The one that it was trained on does not stand in for the others."""
    trained = steady(overrides={})
    (found,) = benches({"p": trained}, scenarios=("auv/nominal", "auv/heavy"))
    assert [v.condition for v in found.verdicts] == ["nominal", "heavy"]


def test_a_policy_of_an_unknown_environment_is_refused():
    policy = good()
    object.__setattr__(policy.manifest, "environment", "navgym/AUVDropout-v9")
    with pytest.raises(ValueError, match=r"environment of policy 'p'.*AUVDropout-v9"):
        benches({"p": policy})


def test_a_policy_that_diverges_is_not_better_and_has_no_gain():
    bad = hand_made.policy(AUV, "auv/switch-D", {(0, "bias"): -1.0}, overrides={"steps": 300})
    (found,) = benches({"bad": bad})
    (verdict,) = found.verdicts
    assert not verdict.better
    assert math.isnan(verdict.gain)
    assert failures([found]) == [
        "bad is not better than the best fixed parameters on switch-D, steps=300: it diverges."
    ]
    assert set(verdict.ahead) == {"hand rule", "imm", "imm_wide", "bank", "bank_2026"}


def test_p_values_are_corrected_for_the_policies_that_were_tried(bench):
    good_, idle_ = bench.verdicts
    assert idle_.p_value == 1.0
    assert good_.p_holm == pytest.approx(2.0 * good_.p_value)
    (alone,) = benches({"good": good()})
    assert alone.verdicts[0].p_holm == pytest.approx(alone.verdicts[0].p_value)


def test_a_policy_must_also_beat_the_fixed_parameters_that_it_starts_from():
    # it starts from q = 20 and stays there: better than the scenario's q = 1, but no policy
    lazy = steady(reference={"process_noise_scale": 20.0, "vb_iterations": 5})
    (found,) = benches({"lazy": lazy})
    (verdict,) = found.verdicts
    assert verdict.low > 0.0
    assert "fixed, as for lazy" in found.find(verdict.condition).main
    assert not verdict.better


def comparison(errors, flags=()):
    entries = [Entry(k, "kf") for k in errors]
    marked = {k: np.full(len(v), k in flags) for k, v in errors.items()}
    problem = problem_of("auv")
    measure = problem.scoring.measures["rmse"]
    rows = rows_of(entries, errors, marked, next(iter(errors)), ("kf", "x"), measure, problem)
    return Comparison(rows, next(iter(errors)), {}, errors, dict.fromkeys(errors, 0.0), {}, measure)


def test_beaten_is_beyond_doubt_and_divergence_beats_nobody():
    rng = np.random.default_rng(0)
    base = rng.uniform(1.0, 2.0, 40)
    found = comparison(
        {"a": base, "b": base - 0.1, "like a": base + rng.permutation([0.2, -0.2] * 20), "gone": base / 9},
        flags=("gone",),
    )  # fmt: skip
    assert beaten(found, "b", "a")
    assert not beaten(found, "a", "b")
    assert not beaten(found, "like a", "a")
    assert not beaten(found, "a", "like a")
    assert beaten(found, "a", "gone")
    assert not beaten(found, "gone", "a")


# ---- what is run


def test_everything_runs_on_test_seeds(bench):
    for result in bench.results:
        about = result.main.as_dict()["recordings"]
        assert {split_of(seed) for seed in about["seeds"]} == {"test"}
        assert about["seeds"][1] - about["seeds"][0] + 1 == SMALL.runs


def test_chunks_of_recordings_join_to_the_same_comparison():
    league = League(AUV, {"idle": idle()}, own_conditions("idle", idle()), SMALL, fallback=False)
    (condition,) = league.own
    whole = joined(league, condition, [play(league, condition, 0, 8)])
    pieces = joined(league, condition, [play(league, condition, *p) for p in ((0, 3), (3, 5))])
    assert parts(league, condition) == [(0, 8)]
    for label, errors in whole.main.errors.items():
        if label != "random":  # its dice are thrown per roll-out
            np.testing.assert_array_equal(pieces.main.errors[label], errors)
    assert whole.main.about == pieces.main.about


def test_the_full_evaluation_has_every_shift_other_scenarios_and_real_tracks(tmp_path):
    league = League(
        AUV, {"idle": idle()}, own_conditions("idle", idle()), Extent(), folder=tmp_path
    )
    conditions = league.conditions()
    assert {c.name for c in conditions if c.kind == SHIFT} == set(SHIFTS)
    assert {c.scenario for c in conditions} >= {"auv/switch-B", "auv/student", "auv/turn"}
    assert [c.loss for c in conditions if c.loss] == [0.1, 0.3, 0.5]
    for c in conditions:  # a shift keeps what the policy's own condition overrides
        if c.kind == SHIFT:
            assert {**WRONG_MODEL, **c.overrides} == dict(c.overrides)
    assert min(league.count(c) for c in conditions if c.kind == OWN) >= 200


def test_a_deck_policy_meets_short_segments_a_mild_sea_and_guessed_flexure():
    policy = hand_made.policy(DECK, "deck/switch-60")
    (league,) = leagues({"p": policy}, Extent())
    names = [c.name for c in league.conditions()]
    assert names == [
        "switch-60", "as trained", "15 s segments", "mild sea", "flexure guessed", "switch-gyro", "switch-30",
    ]  # fmt: skip
    assert league.count(league.conditions()[0]) >= 200


@pytest.fixture(scope="module")
def switching():
    """An idle policy on switch-D, with its fallback."""
    policy = steady("auv/switch-D", overrides={"steps": 400})
    (found,) = evaluate(leagues({"p": policy}, SMALL), progress=False)
    return found


def test_errors_by_regime_add_up_to_the_error_of_all_samples(switching):
    (result,) = switching.own()
    names, errors = evaluation_tables.by_regime(result)
    assert names == ("nominal", "outlier", "manoeuvre")
    counts = [sum((each.regime == g).sum() for each in result.labels) for g in range(3)]
    for label, square in result.main.squared.items():
        mean = np.average(errors[label] ** 2, weights=counts)
        assert mean == pytest.approx(square.mean())
    assert set(A6) <= set(result.main.errors)
    assert list(result.main.errors)[-1] == "oracle"
    assert result.consistency["oracle"]["nis"] == pytest.approx(1.0, abs=0.1)
    assert result.consistency["oracle"]["nees"] == pytest.approx(1.0, abs=0.2)


def test_the_page_says_that_filters_which_learn_nothing_are_ahead(switching, tmp_path):
    (verdict,) = switching.verdicts
    assert {"imm", "imm_wide", "bank"} <= set(verdict.ahead)
    page = evaluation_report.page([switching], {})
    html = report.write_page(tmp_path / "report.html", page).read_text()
    assert "though nothing in them was tuned or learnt" in html
    for label in A6:
        assert f">{label}<" in html
    assert (
        html.count('<div class="wide">') == 3
    )  # ladder, parameters in time, errors around switches


@needs_browser
def test_the_page_fits_in_a_browser(switching, tmp_path):
    page = report.write_page(tmp_path / "report.html", evaluation_report.page([switching], {}))
    check([page], tmp_path)


def test_a_combiner_that_learnt_nothing_is_the_bank(tmp_path, monkeypatch):
    arrays = {name: np.zeros(shape) for name, shape in shapes(MODE_SETS["bank"], UNITS).items()}
    combiner = Combiner(**arrays)
    combiner.save(tmp_path / "combiner")
    monkeypatch.setattr(evaluation, "PRETRAINED", tmp_path)
    combiners = load_combiners([])
    assert list(combiners) == ["bank + combiner"]
    (found,) = benches({"idle": idle()}, combiners=combiners)
    (result,) = found.own()
    errors = result.main.errors
    assert list(errors)[-4:] == [
        "bank",
        "bank_2026",
        "bank + combiner",
        "oracle",
    ]  # the ladder's order
    np.testing.assert_allclose(errors["bank + combiner"], errors["bank"], rtol=1e-9)
    assert result.consistency["bank + combiner"]["nees"] == pytest.approx(
        result.consistency["bank"]["nees"]
    )


def test_a_mixture_stands_in_the_ladder_beside_the_combiner(tmp_path):
    made = mixture()
    (tmp_path / "own").mkdir()
    path = made.save(tmp_path / "own" / "mixture")
    combiners = load_combiners([path])
    assert list(combiners)[-1] == "mixture own"
    (found,) = benches({"idle": idle()}, combiners=combiners)
    (result,) = found.own()
    league = found.league
    cases = league.cases(result.condition, 0, league.count(result.condition))
    states = made.run(cases.batch, fallback=True).states
    errors = league.errors(cases, states, ("rmse",))["rmse"]
    np.testing.assert_allclose(result.main.errors["mixture own"], errors, rtol=1e-12)


def test_jitter_is_how_far_parameters_move_from_decision_to_decision(bench):
    (result,) = bench.own()
    chosen = result.chosen["hand rule"]
    assert result.jitter["hand rule"] > 0.0
    assert np.ptp(chosen["process_noise_scale"]) > 0.0


def test_the_fallback_runs_beside_and_is_counted(switching):
    (result,) = switching.own()
    assert set(result.fallbacks) == {"p + fallback"}
    # an idle policy is its own fallback: in force or not, the estimate is the same
    errors = result.main.errors
    np.testing.assert_allclose(errors["p + fallback"], errors[BEST_FIXED], rtol=1e-6)


@pytest.mark.parametrize("known", [True, False])
def test_a_stream_is_the_policy_where_it_knows_the_sea_and_best_fixed_where_not(known):
    policy = steady("auv/switch-D", bias=0.3, overrides=None)
    policy.low, policy.high = (s * np.full(len(policy.low), 5.0 if known else 0.0) for s in (-1, 1))
    policy = Policy(policy.manifest, policy.layers, None, policy.low, policy.high)
    recordings = simulate_many("auv/switch-D", range(2), steps=100)
    states, shares = stream(policy, recordings, 100)
    batch = StateSpaceBatch.of(recordings)
    rolled = roll_out(Learnt(policy), recordings)
    own = run("qivbf", batch, rolled.schedules, rolled.interval).states
    fixed = run("qivbf", batch, dict(policy.manifest.reference)).states
    if known:
        # until the parameters that it starts from have missed the fixes by less for a while
        np.testing.assert_allclose(states[:, :15], own[:, :15], atol=1e-4)
        assert (shares < 0.9).all()
    else:
        np.testing.assert_allclose(states[:, -20:], fixed[:, -20:], atol=1e-9)
        assert (shares > 0.8).all()


def test_the_deck_is_judged_by_four_quantities(tmp_path):
    weights = {(0, "rate.persistence"): 2.0, (0, "rate.alarm"): -1.0}
    overrides = {"duration": 130.0}
    policy = hand_made.policy(DECK, "deck/switch-60", weights, overrides=overrides)
    own = [Condition("short", "deck/switch-60", overrides, OWN)]
    league = League(DECK, {"p": policy}, own, Extent(quick=True, runs=3), fallback=False)
    result = joined(league, own[0], [play(league, own[0], *p) for p in parts(league, own[0])])
    assert list(result.comparisons) == ["theta_rate", "theta_ac", "theta", "attitude"]
    assert set(result.main.errors) >= {
        "MCC off", "default", "best fixed", "hand rule", "p", "true-regime table", "oracle",
    }  # fmt: skip
    score = {r.label: r.score for r in result.main.rows}
    assert (score["MCC off"], score["true-regime table"]) == (0.0, 1.0)
    bench = Bench(league, (result,), ())
    text = evaluation_tables.as_text([bench])
    # from three recordings there is no interval
    assert re.search(rf"^p .*{result.main['p'].mean:.3f} ", text, re.MULTILINE)
    json.dumps(evaluation_tables.as_json([bench], {}), allow_nan=False)


# ---- the command


@pytest.fixture
def saved(tmp_path, monkeypatch):
    """Runs the command on policies, each saved under its name; returns the status."""
    monkeypatch.delenv(VARIABLE, raising=False)  # no real tracks

    def run(*words, **policies):
        for name, policy in policies.items():
            policy.save(tmp_path / name)
        files = [str(tmp_path / f"{name}.npz") for name in policies]
        out = ["--out", str(tmp_path / "out")]
        return command(["evaluate", *files, "--no-fallback", *out, *words])

    return run


def test_the_command_writes_prints_and_succeeds_with_a_better_policy(saved, tmp_path, capsys):
    assert saved("--quick", "--runs", "8", good=good()) == 0
    out, err = capsys.readouterr()
    html = (tmp_path / "out" / "report.html").read_text()
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    rows = results[AUV]["conditions"][results[AUV]["verdicts"][0]["condition"]]
    for row in rows["comparisons"]["rmse"]["rows"]:
        assert re.search(rf"^{re.escape(row['label'])} ", out, re.MULTILINE)
        if row["divergence_rate"] <= 0.01:
            assert f"{row['mean']:.3f} ± {row['high'] - row['mean']:.3f}" in html
    assert "no A-KIT data" in out
    assert results["provenance"]["command"].startswith("navgym evaluate ")
    assert "NOT BETTER" not in err
    assert html.count('<div class="wide">') == 2  # one regime: no switches to look at
    assert not re.search(r"(src|href)=", html.replace("xlink:href=", ""))


def test_the_same_command_gives_the_same_numbers(saved, tmp_path):
    found = []
    for _ in range(2):
        assert saved("--quick", "--runs", "3", "--scenario", "auv/switch-D", p=idle()) == 1
        results = json.loads((tmp_path / "out" / "results.json").read_text())
        del results["provenance"], results[AUV]["microseconds per filter step"]
        found.append(results)
    assert found[0] == found[1]


def test_the_command_fails_with_a_policy_that_is_not_better(saved, capsys):
    assert saved("--quick", "--runs", "8", good=good(), idle=idle()) == 1
    err = capsys.readouterr().err
    assert "NOT BETTER: idle is not better than the best fixed parameters" in err
    assert "NOT BETTER: good" not in err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--runs", "0"), "runs must be a whole number of at least 2, got 0"),
        (("--runs", "1"), "runs must be a whole number of at least 2, got 1"),
        (("--workers", "0"), "workers must be a whole number of at least 1, got 0"),
        (("--scenario", "auv/swich-D"), "Did you mean 'auv/switch-D'?"),
        (("--scenario", "deck/switch-60"), "cannot serve 'deck/switch-60'"),
        (("--scenario", "auv/coordinated-turn"), "cannot serve 'auv/coordinated-turn'"),
        (("--data", "nowhere"), "nowhere"),
    ],
)
def test_wrong_input_is_one_line(saved, capsys, words, message):
    assert saved("--quick", *words, p=idle()) == 2
    err = capsys.readouterr().err
    assert message in err
    assert "Traceback" not in err


def test_files_that_are_no_policies_are_refused(saved, tmp_path, capsys):
    idle().save(tmp_path / "whole")
    for suffix in ("npz", "json"):
        shutil.copy(tmp_path / f"whole.{suffix}", tmp_path / f"cut.{suffix}")
    content = (tmp_path / "cut.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(content[: len(content) // 2])
    (tmp_path / "foreign.npz").write_bytes(b"not a policy")
    (tmp_path / "foreign.json").write_text("{}")
    for name in ("cut", "foreign", "absent"):
        assert command(["evaluate", str(tmp_path / f"{name}.npz")]) == 2
        err = capsys.readouterr().err
        assert name in err
        assert "Traceback" not in err


def test_without_arguments_the_shipped_policies_are_evaluated(tmp_path, monkeypatch):
    monkeypatch.setattr(evaluation, "PRETRAINED", tmp_path)
    with pytest.raises(ValueError, match=r"holds no policy"):
        load([])
    idle().save(tmp_path / "mine")
    (tmp_path / "other.json").write_text('{"kind": "navgym combiner"}')
    assert list(load([])) == ["mine"]


def test_policies_are_named_after_their_files_or_folders(tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        for name in ("policy", "mine"):
            idle().save(tmp_path / folder / name)
    a, b = tmp_path / "a", tmp_path / "b"
    assert list(load([a / "policy.npz", b / "mine"])) == ["a", "mine"]
    assert list(load([a / "mine.npz", b / "mine.npz"])) == ["a/mine", "b/mine"]
    with pytest.raises(ValueError, match="distinct names"):
        load([a / "mine", a / "mine.npz"])


@pytest.mark.slow
def test_the_numbers_do_not_depend_on_the_workers():
    found = [evaluate(leagues({"p": idle()}, SMALL), n, progress=False)[0] for n in (1, 2)]
    one, two = (evaluation_tables.as_json([b], {})[AUV] for b in found)
    for each in (one, two):
        del each["microseconds per filter step"]
    assert one == two
