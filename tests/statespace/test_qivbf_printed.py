"""QIVBF as printed: the same as its twin, and as bad as its authors' equations make it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import navgym
from navgym.simulation import simulate_many
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters import qivbf_printed
from tests.helpers import problems, run, run_family, same
from tests.twins.printed import printed


@given(
    problem=problems(sizes=((4, 4),), steps=7),
    sweeps=st.integers(1, 6),
    tau=st.floats(0.5, 50.0),
    count0=st.floats(1.0, 50.0),
)
def test_it_agrees_with_its_twin(problem, sweeps, tau, count0):
    """Over a few samples: it diverges, and takes rounding errors along."""
    found = run_family(qivbf_printed, problem.recording, (sweeps, tau, count0))
    twin = printed(problem.model, problem.time, problem.y, problem.lost, sweeps, tau, count0)
    same(found, twin, 1e-8)


@pytest.mark.parametrize("sweeps", [1, 5, 20])
def test_it_diverges_in_most_runs_even_when_nothing_is_lost(sweeps):
    """In about 90 % of runs (docs/science/qivbf.md#errata) an error above a hundred sigma."""
    batch = StateSpaceBatch.of(simulate_many("auv/nominal", range(60), loss=0.0))
    found = run("qivbf_printed", batch, {"vb_iterations": sweeps})
    error = np.abs(found.states - batch.truth)[..., [0, 2]].max((1, 2))
    assert np.mean(~(error < 100.0)) > 0.75
    good = run("qivbf", batch)
    assert np.abs(good.states - batch.truth)[..., [0, 2]].max() < 10.0


def test_its_divergence_is_flagged_and_that_of_the_corrected_filter_does_not_occur():
    batch = StateSpaceBatch.of(simulate_many("auv/nominal", range(60), loss=0.0))
    found = run("qivbf_printed", batch)
    lost = np.abs(found.states - batch.truth)[..., [0, 2]].max((1, 2)) > 100.0
    assert lost.mean() > 0.75
    assert found.diverged[lost].all()
    assert not run("qivbf", batch).diverged.any()


def test_names_and_parameters_reach_the_kernel():
    recording = navgym.simulate("auv/component-loss", 2, steps=8)
    chosen = {"vb_iterations": 3, "prior_count": 7.0, "initial_count": 4.0}
    twin = printed(
        recording.model, recording.time, recording.measurements, recording.lost, *chosen.values()
    )
    same(vars(navgym.estimate("qivbf_printed", recording, chosen)), twin)
