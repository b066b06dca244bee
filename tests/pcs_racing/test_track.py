"""Tracks built from values and from map folders."""

import numpy as np


def test_the_oval_has_the_length_of_a_stadium(oval):
    assert abs(oval.length - (24.0 + 8.0 * np.pi)) < 0.01
    np.testing.assert_allclose(oval.line[:, 7:9], 1.1, atol=0.06)
