"""The sparse update, row by row, against its dense twin; what it does with silence, outliers and failure."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navgym.core import health
from navgym.core.compile import kernel
from navgym.inertial import update
from tests.twins import error_state as twin

N, M, W = 19, 8, 7  # neither a multiple of what the kernels do at once
LANE = np.dtype(update.fields(N, M, W))
RULE = np.dtype(update.RULE)
TRUST, GATE, ROBUST = range(3)


@kernel
def run(lanes, rules, how, limit, listen):
    """One update of every lane."""
    for i in range(len(lanes)):
        lane = lanes[i]
        if listen:
            update.hear(lane)
        update.judge(lane)
        update.expect(lane)
        if how == ROBUST:
            update.robust(lane, rules[0], limit)
        else:
            if how == GATE:
                update.gate(lane, limit)
            else:
                update.trust(lane)
            update.correct(lane, 0)
        update.check(lane)


def updated(lanes, how=TRUST, limit=3.0, listen=False, **rule):
    """A copy of the lanes after one update."""
    found, rules = lanes.copy(), np.zeros(1, RULE)
    for name, value in ({"iterations": 1} | rule).items():
        rules[name] = value
    run(found, rules, how, limit, listen)
    return found


def problem(seed):
    """A lane (1,) with rows of 1 to 7 random states, innovations as S expects, and its dense H."""
    rng = np.random.default_rng(seed)
    rows = [rng.permutation(N)[: rng.integers(1, W + 1)] for _ in range(M)]
    lane = np.zeros(1, LANE)
    update.touch(lane, rows)
    A = rng.standard_normal((N, N + 3)) * 10.0 ** rng.uniform(-3, 1, (N, 1))
    lane["x"], lane["P"] = rng.standard_normal(N), A @ A.T
    lane["H"] = rng.standard_normal((M, W))
    lane["used"] = 1
    H = twin.dense(lane["H"][0], rows, N)
    spread = np.diag(H @ lane["P"][0] @ H.T)
    lane["R"] = spread * 10.0 ** rng.uniform(-1, 2, M)
    lane["innovation"] = np.sqrt(spread + lane["R"]) * rng.standard_normal(M)
    return lane, H


def parts(lane):
    """What the twin takes: x, P, innovation of lane 0, and its R."""
    return *(lane[n][0] for n in ("x", "P", "innovation")), lane["R"][0]


def agree(found, x, P, tolerance=1e-8):
    """In units of standard deviations."""
    sd = np.sqrt(np.diag(P))
    assert (np.abs(found["x"][0] - x) / sd).max() < tolerance
    assert (np.abs(found["P"][0] - P) / np.outer(sd, sd)).max() < tolerance


seeds = given(seed=st.integers(0, 2**32 - 1))


@seeds
def test_rows_one_by_one_are_the_block_in_joseph_form(seed):
    lane, H = problem(seed)
    found = updated(lane)
    x, P, e, R = parts(lane)
    agree(found, *twin.correct(x, P, e, H, R))
    nis, log_likelihood = twin.judge(P, e, H, R)
    assert found["nis"][0] == pytest.approx(nis, rel=1e-8)
    assert found["log_likelihood"][0] == pytest.approx(log_likelihood, rel=1e-8)
    assert found["variance"][0] == pytest.approx(np.diag(H @ P @ H.T) + R, rel=1e-12)


@seeds
def test_the_order_of_rows_changes_nothing_but_rounding(seed):
    lane, _ = problem(seed)
    order = np.random.default_rng(seed).permutation(M)
    turned = lane.copy()
    for name in ("innovation", "H", "R", "index", "touched"):
        turned[name] = lane[name][:, order]
    one, other = updated(lane), updated(turned)
    agree(one, other["x"][0], other["P"][0])
    assert one["nis"][0] == pytest.approx(other["nis"][0], rel=1e-8)


@pytest.mark.parametrize("by_noise", [False, True])
@pytest.mark.parametrize("iterations", [1, 3])
@settings(max_examples=20)
@seeds
def test_weights_divide_r(iterations, by_noise, seed):
    lane, H = problem(seed)
    lane["innovation"][0, 2] *= 5.0
    found = updated(lane, ROBUST, 4.0, iterations=iterations, by_noise=by_noise)
    x, P, e, R = parts(lane)
    x, P, C = twin.robust(x, P, e, H, R, 4.0, iterations, by_noise)
    if C.min() > update.FLOOR:
        assert found["weight"][0] == pytest.approx(C, rel=1e-6)
        agree(found, x, P, 1e-6)


def test_a_kernel_of_fifty_is_the_plain_update_to_the_bit():
    lane, _ = problem(1)
    assert updated(lane, ROBUST, 50.0).tobytes() == updated(lane).tobytes()


def test_the_largest_outlier_moves_nothing_behind_a_kernel():
    lane, _ = problem(2)
    lane["innovation"][0, 3] = 1e9 * np.sqrt(lane["R"][0, 3])
    found = updated(lane, ROBUST, 3.0)
    assert found["weight"][0, 3] == update.FLOOR
    sd = np.sqrt(np.diag(found["P"][0]))
    lane["used"][0, 3] = 0
    without = updated(lane, ROBUST, 3.0)
    assert (np.abs(found["x"] - without["x"]) / sd).max() < 0.01


def test_a_row_beyond_the_gate_is_left_out_but_counts_for_health():
    lane, _ = problem(3)
    lane["innovation"][0] = 0.5 * np.sqrt(lane["R"][0])
    lane["innovation"][0, 5] = 200.0 * np.sqrt(lane["R"][0, 5] * 1e3)
    found = updated(lane, GATE, 4.0)
    assert found["weight"][0].tolist() == [1.0] * 5 + [0.0] + [1.0] * 2
    lane["used"][0, 5] = 0
    without = updated(lane)
    np.testing.assert_array_equal(found["x"], without["x"])
    np.testing.assert_array_equal(found["P"], without["P"])
    assert found["power"][0] > 10.0 * without["power"][0]


def test_a_row_that_is_not_a_number_is_as_if_it_were_not_there():
    lane, H = problem(4)
    silent = [0, 3, 7]
    lane["innovation"][0, silent] = np.nan
    lane["R"][0, 3] = np.nan
    found = updated(lane, listen=True)
    rest = [c for c in range(M) if c not in silent]
    assert np.flatnonzero(found["used"][0]).tolist() == rest
    x, P, e, R = parts(lane)
    agree(found, *twin.correct(x, P, e[rest], H[rest], R[rest]))
    nis, log_likelihood = twin.judge(P, e[rest], H[rest], R[rest])
    assert found["nis"][0] == pytest.approx(nis, rel=1e-8)
    assert found["log_likelihood"][0] == pytest.approx(log_likelihood, rel=1e-8)
    assert found["diverged"][0] == 0


def test_silence_leaves_everything_as_it_was():
    lane, _ = problem(5)
    lane["innovation"], lane["power"] = np.nan, 7.0
    found = updated(lane, listen=True)
    for name in ("x", "P", "power", "diverged"):
        np.testing.assert_array_equal(found[name], lane[name])
    assert np.isnan(found["nis"][0])
    assert np.isnan(found["log_likelihood"][0])


@pytest.mark.parametrize(
    ("field", "value"), [("x", np.nan), ("P", -1.0), ("P", np.inf), ("innovation", np.nan)]
)
def test_a_lane_whose_numbers_fail_says_so_and_leaves_the_others_alone(field, value):
    lanes = np.concatenate([problem(6)[0]] * 2)
    where = (1, 4, 4) if field == "P" else (1, 4)
    lanes[field][where] = value
    if field == "P":
        lanes["touched"] = 0  # no row sees it, the diagonal does
    found = updated(lanes)
    assert found["diverged"].tolist() == [0, health.NUMERICAL]
    assert np.isnan(found["x"][1]).all()
    assert np.isnan(found["P"][1]).all()
    assert np.isfinite(found["P"][0]).all()


def test_an_innovation_variance_below_zero_is_a_failure():
    lane, _ = problem(7)
    lane["R"][0, 0] = -1e9
    assert updated(lane)["diverged"][0] == health.NUMERICAL


def test_a_spike_is_no_runaway_and_a_hundred_sigma_for_long_is():
    lane, _ = problem(8)
    lane["innovation"][0, 0] = 1e150
    assert updated(lane, GATE, 5.0)["diverged"][0] == 0
    lane, _ = problem(8)
    lane["innovation"] = 150.0 * np.sqrt(updated(lane)["variance"])
    flags = []
    for _ in range(40):
        lane = updated(lane, GATE, 5.0)
        flags.append(int(lane["diverged"][0]))
    assert flags[0] == 0
    assert flags[-1] == health.RUNAWAY
    assert np.isfinite(lane["x"]).all()


@pytest.mark.parametrize(
    "rows", [[[0]] * (M - 1), [[0]] * (M - 1) + [range(W + 1)], [[0]] * (M - 1) + [[N]]]
)
def test_rows_that_do_not_fit_are_refused(rows):
    with pytest.raises(ValueError, match=f"rows must be {M}, of at most {W} states below {N}"):
        update.touch(np.zeros(1, LANE), rows)
