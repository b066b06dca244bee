"""Known labels: information of the opponent's place, and opponents of a fit."""

import numpy as np
import pytest

from studies.reading import information, right

RNG = np.random.default_rng(3)


def test_information_is_that_of_the_opponent_beyond_what_is_given():
    given, place = RNG.integers(2, size=(2, 4000))
    assert information(place, place ^ given, given) == pytest.approx(1.0, abs=0.01)
    # the move follows from the input
    assert information(place, given, given) == pytest.approx(0.0, abs=1e-9)
    assert 0.0 <= information(place, RNG.integers(2, size=4000), given) < 0.005


def test_a_rule_is_tested_on_opponents_that_it_has_not_seen():
    place, half = RNG.integers(2, size=(2, 400))
    assert right(place, 3 * place, half).all()
    # the other half of the opponents is met with the other move
    assert not right(place, place ^ half, half).any()
    only = np.where(half == 0, 5, place)  # a cell that one half never sees
    assert right(only, place, half, np.ones(400, np.bool_))[half == 0].all()
