"""A track behind one address."""

import numpy as np
import pytest
from numba.core.errors import TypingError

from pcs_racing import load_track
from pcs_racing.base.compilation import compiled, kernel
from pcs_racing.track.frenet import project, wall_distance, wrap_s
from pcs_racing.track.reference import refer_to


@kernel
def length_and_first_sample(track, out):
    reference = refer_to(track)
    out[0] = reference.length
    out[1] = reference.line[0, 1]
    out[2] = reference.lookup[2, 3]
    out[3] = reference.lookup_cell


@compiled
def through_functions(track, x, y):
    reference = refer_to(track)
    s, d = project(reference, x, y, 3.0)
    return s, d, wall_distance(reference, x, y), wrap_s(reference, -1.0)


@kernel
def unknown(track):
    return refer_to(track).width


def test_it_has_the_attributes_of_the_track():
    track, out = load_track("Pipkin").arrays, np.zeros(4)
    length_and_first_sample(track, out)
    assert out.tolist() == [track.length, track.line[0, 1], track.lookup[2, 3], track.lookup_cell]


def test_functions_of_a_track_take_it():
    track = load_track("Pipkin").arrays
    x, y = track.line[40, :2] + 0.1
    expected = (*project(track, x, y, 3.0), wall_distance(track, x, y), wrap_s(track, -1.0))
    assert through_functions(track, x, y) == expected


def test_what_a_track_does_not_have_is_an_error():
    with pytest.raises(TypingError, match="width"):
        unknown(load_track("Pipkin").arrays)
