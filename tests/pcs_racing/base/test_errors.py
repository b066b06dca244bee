import math
from pathlib import Path

import numpy as np
import pytest
from refusal import refused

from pcs_racing.base import errors
from pcs_racing.base.errors import ConfigError, InputError


def test_whole_and_other_numbers_within_a_range_and_huge_ones():
    assert [errors.check_whole("n", good, 0, 5) for good in (0, 5, np.uint8(3))] == [0, 5, 3]
    assert type(errors.check_whole("n", np.int64(3), 0, 5)) is int
    for value in [True, 1.0, "1", None, np.True_, np.float64(1.0), -1, 6, [1]]:
        refused(r"^n is .* from 0 to 5$", errors.check_whole, "n", value, 0, 5)
    assert [errors.check_number("x", good, 0.0, 1.0) for good in (0, 1.0, np.float32(0.5))] == [
        0.0,
        1.0,
        0.5,
    ]
    assert type(errors.check_number("x", np.float32(0.5))) is float
    for value in [True, "1", None, math.nan, math.inf, -math.inf, -0.1, 1.1, 0.0]:
        refused(
            r"^x is .* above 0 up to 1$", errors.check_number, "x", value, maximum=1.0, above=0.0
        )
    assert errors.check_number("x", 10**400) == 10**400
    refused("from 0 to 1", errors.check_number, "x", 10**400, 0.0, 1.0)


def test_texts_flags_paths_seeds_and_names_that_resemble():
    assert errors.check_flag("normalize", np.True_) is True
    assert errors.check_path("folder", Path("a")) == Path("a")
    for path in ("a\0b", Path("a\0b"), "\ud800", ""):
        refused("folder is .*; it must be a name or a path", errors.check_path, "folder", path)
    assert errors.check_seed(np.uint64(7)) == 7
    for check, odd in (
        (errors.check_flag, 1),
        (errors.check_text, ""),
        (errors.check_path, ""),
        (errors.check_path, 3),
        (errors.check_names, "abc"),
        (errors.check_names, ("a", "a")),
    ):
        refused(r"^it (is|are) ", check, "it", odd)
    refused("seed is -1", errors.check_seed, -1)
    assert errors.check_choice("kind", "map", ("map", "kdpp")) == "map"
    refused(
        r"kind is 'mpa'; it must be one of map, kdpp \(did you mean 'map'\?\)",
        errors.check_choice,
        "kind",
        "mpa",
        ("map", "kdpp"),
    )
    for odd in (None, 3, ["map"], "lattice"):
        refused(
            r"one of map, kdpp$",
            errors.check_choice,
            "kind",
            odd,
            ("map", "kdpp"),
            ConfigError,
            error=ConfigError,
        )


def test_arrays_of_whole_numbers():
    np.testing.assert_array_equal(
        errors.check_whole_array("n", [[1, 2]], (None, 2), minimum=0, maximum=2), [[1, 2]]
    )
    assert errors.check_whole_array("n", np.uint8(3)).dtype == np.int64
    assert errors.check_whole_array("n", [], (None,)).tolist() == []
    for wrong in ([[1.0, 2.0]], [[True, False]], [["a", "b"]], [[1], [2, 3]]):
        refused(r"^n has shape .* type", errors.check_whole_array, "n", wrong, (None, 2))
    refused(r"^n is 2\.5;", errors.check_whole_array, "n", 2.5, (None,))
    refused(
        r"^n has shape \(3,\) .*\(2,\) or \(4, 2\)",
        errors.check_whole_array,
        "n",
        [1, 2, 3],
        (2,),
        (4, 2),
    )
    refused(
        r"^n holds -1 at \(0, 1\); .* from 0 to 5",
        errors.check_whole_array,
        "n",
        [[1, -1]],
        (1, 2),
        minimum=0,
        maximum=5,
    )
    refused(r"^n is 6; .* up to 5", errors.check_whole_array, "n", 6, maximum=5)


def test_arrays():
    for value, message in [
        ([[1.0, 2.0]], "theta has shape (1, 2); it must have (any, 3)"),
        ([1.0, 2.0, 3.0], "theta has shape (3,); it must have (any, 3)"),
        ([[1.0, 2.0, np.nan]], "theta holds nan at (0, 2); it must be finite from 0 to 9"),
        ([[1.0, 2.0, 10.0]], "theta holds 10.0 at (0, 2)"),
        ([["a", 2.0, 10.0]], "it must hold numbers"),
        ([[1.0], [2.0, 3.0]], "it must hold numbers"),
    ]:
        good = np.zeros((2, 3))
        assert errors.check_array("theta", good, (None, 3)) is not good
        with pytest.raises(InputError) as error:
            errors.check_array("theta", value, (None, 3), minimum=0.0, maximum=9.0)
        assert message in str(error.value)


@pytest.mark.parametrize("size", [1, 32, 33, 1000])
@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_whether_all_are_finite(size, wrong):
    values = np.full((size, 1), 1e300)
    assert errors.all_finite(values)
    values[-1] = wrong
    assert not errors.all_finite(values)
