"""Slices, first states and indices all follow from one declaration."""

import pytest

from navgym.deck.alignment import LAYOUT
from navgym.inertial.states import Layout, State

INS = Layout(
    State("ATTITUDE", "φ", "rad", "attitude error"),
    State("DEPTH", "z", "m", "depth error", 1),
    State("BEAMS", "b", "m/s", "biases of a DVL's beams", 4),
)


def test_blocks_follow_one_another():
    assert INS.size == 8
    assert INS.slices == (slice(0, 3), slice(3, 4), slice(4, 8))
    assert INS.first == (0, 3, 4)
    assert INS.first.BEAMS == 4
    assert INS.indices("BEAMS", "DEPTH") == (4, 5, 6, 7, 3)


def test_names_are_distinct():
    with pytest.raises(ValueError, match="distinct"):
        Layout(State("A", "a", "1", ""), State("A", "b", "1", ""))


def test_the_deck_filters_states_are_those_of_the_paper():
    """IDAM eq. 73."""
    assert [s.symbol for s in LAYOUT.states] == ["l", "δV", "φ", "ε", "∇", "V_r", "θ", "θ̇"]
    assert LAYOUT.size == 24
