"""The update of a sensor's rows under each rule, against dense twins."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navgym.core.compile import kernel
from navgym.inertial import block_update as b
from tests.twins import block as twin

N, W = 13, 6
LANE = np.dtype(b.block_fields(N, W))
TRUST, GATE, STUDENT, CORRENTROPY, VARIATIONAL, BANK = range(6)


@kernel
def update(lane, how, value):
    """One block of a lane by a rule."""
    b.project_block(lane)
    b.judge_block(lane)
    if how == STUDENT:
        b.weigh_student(lane, value, 4)
    elif how == CORRENTROPY:
        b.weigh_correntropy(lane, value)
    elif how == VARIATIONAL:
        b.weigh_variational(lane, 2, value, 3)
    elif how == BANK:
        b.weigh_bank(lane, 2)
    else:
        b.weigh_gate(lane, value)
    b.apply_block(lane)


def problem(seed, rows):
    """A lane (1,) with a block of random states, its dense H, P, r and R."""
    rng = np.random.default_rng(seed)
    touched = rng.permutation(N)[: rng.integers(1, W + 1)]
    lane = np.zeros(1, LANE)
    b.remember_nothing(lane)
    A = rng.standard_normal((N, N + 3)) * 10.0 ** rng.uniform(-2, 1, (N, 1))
    P, H = A @ A.T, np.zeros((rows, N))
    H[:, touched] = rng.standard_normal((rows, len(touched)))
    R = np.diag(np.diag(H @ P @ H.T) * 10.0 ** rng.uniform(-1, 1, rows))
    r = np.linalg.cholesky(H @ P @ H.T + R) @ rng.standard_normal(rows) * rng.choice([1.0, 4.0])
    lane["P"], lane["touched"], lane["rows"] = P, len(touched), rows
    lane["index"][0, : len(touched)] = touched
    lane["H"][0, :rows, : len(touched)] = H[:, touched]
    lane["r"][0, :rows], lane["R"][0, :rows] = r, np.diag(R)
    return lane, P, H, r, R


def updated(lane, how, value=np.inf):
    found = lane.copy()
    update(found[0], how, value)
    return found[0]


def agree(found, dx, P, tolerance=1e-7):
    """In units of standard deviations."""
    sd = np.sqrt(np.diag(P))
    assert (np.abs(found["dx"] - dx) / sd).max() < tolerance
    assert (np.abs(found["P"] - P) / np.outer(sd, sd)).max() < tolerance


blocks = given(seed=st.integers(0, 2**32 - 1), rows=st.sampled_from([1, 3]))
few = settings(max_examples=25)


@few
@blocks
def test_trusting_is_the_kalman_update_in_joseph_form(seed, rows):
    lane, *world = problem(seed, rows)
    found = updated(lane, TRUST)
    agree(found, *twin.correct(*world))
    nis, log = twin.judge(*world)
    assert found["block_nis"] == pytest.approx(nis, rel=1e-8)
    assert found["block_log"] == pytest.approx(log, rel=1e-8, abs=1e-8)
    assert found["weight"] == 1.0


@few
@blocks
def test_robust_rules_are_their_sources_formulas(seed, rows):
    lane, *world = problem(seed, rows)
    for how, value, rule in (
        (STUDENT, 3.0, lambda *w: twin.student(*w, 3.0, 4)),
        (CORRENTROPY, 4.0, lambda *w: twin.correntropy(*w, 4.0)),
    ):
        found = updated(lane, how, value)
        dx, P, weight = rule(*world)
        agree(found, dx, P)
        assert found["weight"] == pytest.approx(weight, rel=1e-7)


@few
@blocks
def test_the_variational_rule_estimates_a_scale_and_remembers_it(seed, rows):
    lane, *world = problem(seed, rows)
    found = updated(lane, VARIATIONAL, 0.9)
    dx, P, scale = twin.variational(*world, b.VB_START, b.VB_START, 0.9, 3)
    if b.VB_LEAST < scale < b.VB_MOST:
        agree(found, dx, P)
        count = 0.9 * b.VB_START + rows
        assert found["count"][2] == pytest.approx(count)
        assert found["sum"][2] == pytest.approx(scale * count, rel=1e-7)
    assert (found["count"][[0, 1, 3]] == b.VB_START).all()


@few
@blocks
def test_the_bank_is_a_mixture_of_updates_moment_matched(seed, rows):
    lane, *world = problem(seed, rows)
    chance = np.random.default_rng(seed).dirichlet(np.ones(len(b.SCALES)))
    lane["chance"][0, 2] = chance
    found = updated(lane, BANK)
    dx, P, after, log = twin.bank(*world, chance)
    agree(found, dx, P, 1e-6)
    np.testing.assert_allclose(found["chance"][2], after, atol=1e-9)
    assert found["block_log"] == pytest.approx(log, rel=1e-7, abs=1e-7)
    assert np.linalg.eigvalsh(found["P"]).min() > -1e-9 * np.abs(found["P"]).max()


def test_beyond_the_gate_nothing_changes():
    lane, P, H, r, R = problem(4, 3)
    nis = twin.judge(P, H, r, R)[0]
    shut, open_ = (updated(lane, GATE, f * nis) for f in (0.99, 1.01))
    np.testing.assert_array_equal(shut["P"], P)
    assert not shut["dx"].any()
    assert shut["weight"] == 0.0
    agree(open_, *twin.correct(P, H, r, R))
