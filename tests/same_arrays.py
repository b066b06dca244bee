"""How tests say that arrays are the same to the last bit."""

import numpy as np


def assert_same(found, expected, skip=(), strict=True):
    """Arrays by name, of a dictionary or of a state and its parts: the same names, shapes,
    types and numbers.
    """
    found, expected = (
        arrays._asdict() if hasattr(arrays, "_asdict") else arrays for arrays in (found, expected)
    )
    assert found.keys() == expected.keys()
    for name, array in expected.items():
        if hasattr(array, "_asdict"):
            assert_same(found[name], array, skip, strict)
        elif name not in skip:
            np.testing.assert_array_equal(found[name], array, err_msg=name, strict=strict)
