"""Searches by a population against mealpy, whose draws they share."""

import numpy as np
import pytest

from navgym.identification import search

LOW, HIGH = np.array([-2.0, -3.0, -1.0]), np.array([2.0, 1.0, 4.0])
PEERS = {"whale": ("WOA", "OriginalWOA"), "swarm": ("PSO", "OriginalPSO")}
SIZE, EPOCHS = 20, 60


def hilly(places):
    """(P,) a bowl with hills in it."""
    bowl = (places - [0.3, -1.0, 2.0]) ** 2 * [1.0, 3.0, 0.2]
    return np.sum(bowl + 0.3 * np.sin(5.0 * places), axis=-1)


def peer(name, seed):
    """Place and cost that mealpy ends with."""
    mealpy = pytest.importorskip("mealpy")
    module, method = PEERS[name]
    problem = {
        "bounds": mealpy.FloatVar(lb=tuple(LOW), ub=tuple(HIGH)), "minmax": "min",
        "obj_func": lambda x: float(hilly(x)), "log_to": None,
    }  # fmt: skip
    found = getattr(getattr(mealpy, module), method)(epoch=EPOCHS, pop_size=SIZE)
    best = found.solve(problem, seed=seed)
    return best.solution, best.target.fitness


@pytest.mark.parametrize("seed", [0, 1, 6])
@pytest.mark.parametrize("name", PEERS)
def test_a_search_ends_where_mealpy_does_to_the_bit(name, seed):
    method = getattr(search, name)
    place, least = method(hilly, LOW, HIGH, seed=seed, population=SIZE, epochs=EPOCHS)
    wanted, cost = peer(name, seed)
    np.testing.assert_array_equal(place, wanted)
    assert least == cost


@pytest.mark.parametrize("name", PEERS)
def test_a_search_asks_for_no_place_outside_its_box(name):
    asked = []
    method = getattr(search, name)
    method(
        lambda p: asked.append(p.copy()) or hilly(p), LOW, HIGH, seed=3, population=10, epochs=20
    )
    assert len(asked) == 21  # the first places and twenty generations
    assert ((np.concatenate(asked) >= LOW) & (np.concatenate(asked) <= HIGH)).all()


def test_where_no_cost_is_a_number_the_first_place_is_the_answer():
    low, high = np.zeros(2), np.ones(2)
    for find in (search.whale, search.swarm):
        place, least = find(
            lambda p: np.full(len(p), np.nan), low, high, seed=1, population=4, epochs=3
        )
        assert least == np.inf
        assert ((place >= low) & (place <= high)).all()
