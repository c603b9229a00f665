"""The reproduction covers what the papers print, and each of its parts says what holds."""

import json
from dataclasses import replace

import numpy as np
import pytest

import navgym
from navgym.deck.log_columns import COLUMNS
from navgym.metrics import paired_difference
from navgym.statespace.recording import Recording
from navgym.tuning.papers import (
    claims,
    expected_idam,
    idam,
    idam_figures,
    idam_ship,
    ins,
    ins_tables,
    part,
    qivbf,
)
from navgym.tuning.papers import qivbf_figures as figures
from navgym.tuning.papers.claims import FAILS, HOLDS, PARTLY, Finding, judge
from navgym.tuning.papers.dead_reckoning import dead_reckon
from navgym.tuning.papers.expected import Check
from navgym.tuning.report.page import Section, write_page

# read off the papers: all that they number, and the numbers that section 5 of IDAM states in words
PRINTED = {
    "QIVBF": ["figure 1", "figure 2", "figure 3", "figure 4", "table 1", "table 2"],
    "IDAM": [
        *(f"figure {i}" for i in range(1, 11)), "table 1", "table 2", "section 5 (setting)",
        "section 5 (numbers)",
    ],
}  # fmt: skip
TINY = replace(qivbf.QUICK, runs=4, steps=60)


@pytest.fixture(scope="module")
def shown():
    """QIVBF's figures on a few short recordings."""
    return list(figures.figures(TINY))


@pytest.fixture(scope="module")
def ship():
    return idam_ship.layout()


@pytest.mark.parametrize(("paper", "where"), [(p, w) for p, all_ in PRINTED.items() for w in all_])
def test_everything_that_a_paper_prints_is_a_claim_with_a_reason(paper, where):
    claim = getattr(claims, paper)[where]
    assert (claim.paper, claim.where) == (paper, where)
    assert len(claim.says) > 20
    assert len(claim.why) > 20


def test_each_figure_and_table_of_qivbf_is_judged_once(shown):
    judged = [f.claim.where for p in shown for f in p.findings]
    assert sorted(judged) == PRINTED["QIVBF"]


def test_every_part_has_a_check_and_a_verdict(shown, ship):
    for each in [*shown, ship]:
        assert each.checks, each.section.title
        assert each.findings, each.section.title
        assert all(f.found for f in each.findings)


def test_what_fails_of_figure_4_is_told_from_the_runs(shown):
    """Four short runs suffice: zeros pull the filter away, and the printed filter is lost."""
    finding = next(f for p in shown for f in p.findings if f.claim.where == "figure 4")
    assert finding.verdict != HOLDS
    at = next(p for p in shown if p.section.title.startswith("Figure 4")).found["0.3 lost"]
    means = {row["label"]: row["mean"] for row in at["rows"]}
    assert means[figures.ZEROS] > 3.0 * means[figures.PREDICTS]
    assert means[figures.PRINTED] > 3.0 * means[figures.CORRECTED]


def test_table_2_of_qivbf_is_the_models_default(shown):
    assert [c.verdict for c in shown[0].checks] == ["within"] * 3


def test_the_setting_of_section_5_is_the_papers():
    setting = idam_figures.setting(replace(idam.QUICK, duration=75.0))
    assert setting.checks[0].holds
    assert ["duration", "–", "75 s, scored from 60 s on"] in setting.section.items[0].rows


def test_a_log_in_the_layout_of_table_1_is_read(ship, tmp_path):
    """26 columns as navgym names them, and the reference that both PHINS give."""
    assert all(c.holds for c in ship.checks)
    path = tmp_path / "ship.csv"
    idam_ship.write_log(path, idam_ship.made_up())
    head, first = path.read_text().splitlines()[:2]
    assert set(head.split(",")) == set(COLUMNS) - {"qx", "qy", "qz", "qw"}
    assert first.count(",") == head.count(",")
    one, two = expected_idam.INSTALLED
    back = navgym.read("deck_csv", path, lever_arm=(10, 10, 2), deviation1=one, deviation2=two)
    assert back.reference is not None
    assert back.meta["latitude"] == pytest.approx(45.0)


def test_the_papers_gains_follow_from_its_rmse():
    for method, gain in expected_idam.PAPER_GAINS.items():
        assert idam_figures._printed_gain(method) == pytest.approx(gain, abs=0.006)
    sea = {m: np.array(v) for m, v in expected_idam.PAPER_SEA.items()}
    for (a, b), gains in expected_idam.PAPER_SEA_GAINS.items():
        assert 100 * (1 - sea[a] / sea[b]) == pytest.approx(gains, abs=0.006)


def test_the_page_begins_with_the_claims_and_warns_of_few_runs(shown, ship, tmp_path):
    made = part.page([*shown, ship], {})
    assert "4 recordings" in made.lede[0]
    assert made.sections[0].title == "What the paper prints, and what holds"
    assert [row[0] for row in made.sections[0].items[0].rows] == [
        "figure 1", "table 1", "table 2", "figure 2", "figure 3", "figure 4", "table 1", "table 2",
    ]  # fmt: skip
    html = write_page(tmp_path / "page.html", made).read_text()
    assert all(each.section.title in html for each in shown)


def test_results_are_json_with_claims_and_checks(shown):
    found = json.loads(json.dumps(part.results(shown, {}), allow_nan=False))
    for each in found["parts"].values():
        assert each["checks"]
        assert each["claims"][0]["verdict"] in claims.VERDICTS


def test_enough_runs_need_no_warning():
    check = Check("a figure", 1.0, 1.0, 0.0, 0.1)
    full = part.Part(Section("full", []), (check,), runs=part.ENOUGH)
    assert not any("quick" in text for text in part.page([full], {}).lede)


@pytest.mark.parametrize(
    ("parts", "verdict"), [((True, True), HOLDS), ((True, False), PARTLY), ((False, False), FAILS)]
)
def test_a_claim_holds_as_far_as_its_parts_do(parts, verdict):
    assert judge(*parts) == verdict


def test_a_verdict_is_one_of_five():
    with pytest.raises(ValueError, match="verdict must be one of"):
        Finding(claims.QIVBF["figure 1"], "perhaps", "")


@pytest.mark.slow
def test_everything_that_idam_prints_is_judged_once_and_every_part_has_a_check():
    parts = list(idam.deck(idam.QUICK, None, None))
    judged = [f.claim.where for p in parts for f in p.findings]
    assert sorted(judged) == sorted(claims.IDAM)
    assert set(PRINTED["IDAM"]) < set(judged)
    assert all(p.checks for p in parts)


class TestIns:
    def test_dead_reckoning_with_the_right_way_and_no_noise_is_the_truth(self):
        time = np.arange(1.0, 101.0)
        way = np.stack([1.5 * np.sin(0.05 * time), 1.5 * np.cos(0.05 * time)], axis=1)
        place = np.cumsum(way, axis=0)
        truth = np.stack([place[:, 0], way[:, 0], place[:, 1], way[:, 1]], axis=1)
        model = navgym.LinearModel.white_acceleration(1.0, position_noise=1.0, x0=np.zeros(4))
        lost = np.ones((100, 4), bool)
        lost[::10] = False
        log = Recording(time=time, measurements=truth, lost=lost, truth=truth, model=model)
        exact, cost = dead_reckon(log, way, (1e-4, 1e-4))
        np.testing.assert_allclose(exact[:, [0, 2]], place, atol=1e-9)
        assert cost < 1e-12
        # a log that says 1 % too much: its scale is found by the fixes
        more, _ = dead_reckon(log, 1.01 * way, (1e-6, 1e-6))
        assert np.hypot(*(more[-1, [0, 2]] - place[-1])) < 0.3 * 0.01 * np.hypot(*way.T).sum()

    def test_a_verdict_on_the_conclusion_follows_from_the_gains(self):
        rng = np.random.default_rng(0)
        base = 1.0 + 0.1 * rng.random(24)
        gains = {n: paired_difference(k * base, base) for n, k in (("a", 0.5), ("b", 2.0))}
        assert ins_tables._judged(gains).verdict == PARTLY
        assert ins_tables._judged({"a": gains["a"]}).verdict == HOLDS
        assert ins_tables._judged({"b": gains["b"]}).verdict == FAILS

    def test_shortened_missions_say_so_and_whole_ones_do_not(self):
        assert ins.QUICK.told == ins.QUICK.runs
        assert ins.FULL.told is None
        assert ins.FULL.runs >= 20

    @pytest.mark.slow
    def test_every_part_has_checks_and_the_models_claims_are_judged_once(self):
        parts = list(ins.ins(replace(ins.QUICK, runs=2, duration=130.0), None))
        assert all(p.checks for p in parts)
        judged = [f.claim.where for p in parts for f in p.findings]
        assert sorted(judged) == ["conclusion", "equations 3-4"]
        json.dumps(part.results(parts, {}), allow_nan=False)
