import copy

import pytest

from pcs_racing.base.recently_used import RecentlyUsed


def test_the_values_used_last_are_kept_and_none_that_can_not_be_made():
    made = []
    values = RecentlyUsed(2)

    def get(key):
        return values.get(key, lambda: made.append(key) or key * 10)

    assert [get(key) for key in (1, 2, 1, 3)] == [10, 20, 10, 30]
    assert made == [1, 2, 3]
    get(1)  # was used after 2, so 2 had to go
    assert made == [1, 2, 3]
    get(2)
    assert made == [1, 2, 3, 2]
    values = RecentlyUsed(2)

    def fail():
        raise KeyError("no")

    with pytest.raises(KeyError):
        values.get(1, fail)
    assert values.get(1, lambda: "made") == "made"


def test_a_copy_refers_to_what_was_copied_with_it():
    shared = [0]
    values = RecentlyUsed(2)
    values.get(1, lambda: shared)
    other, theirs = copy.deepcopy((values, shared))
    theirs[0] = 5
    assert other.get(1, list) is theirs
    assert values.get(1, list) == [0]
