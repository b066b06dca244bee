from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcs_racing import InputError
from pcs_racing_agents.trees.paths import check_size, own_histories, policy_paths


@given(
    table=st.integers(1, 5).flatmap(
        lambda k: st.lists(st.lists(st.integers(0, k - 1), min_size=3, max_size=3), min_size=k, max_size=k)
    ),
    moves=st.integers(0, 3),
)
def test_every_history_goes_along_its_policies_and_no_path_comes_twice(table, moves):
    paths = policy_paths(np.array(table), 0, moves)

    def along(level: int, path: int) -> tuple[int, ...]:
        policy = int(paths.policy[level][path])
        return (*along(level - 1, int(paths.parent[level][path])), policy) if level else (policy,)

    for level in range(moves + 1):
        every = [along(level, path) for path in range(paths.count(level))]
        assert len(set(every)) == len(every)
        for history, path in zip(product(range(3), repeat=level), paths.history[level], strict=True):
            expected = [0]
            for move in history:
                expected.append(table[expected[-1]][move])
            assert every[path] == tuple(expected)


def test_joint_histories_stand_in_row_major_order():
    first, second = own_histories(2, 3)
    for i, (a0, b0, a1, b1) in enumerate(product(range(3), repeat=4)):
        assert (first[i], second[i]) == (a0 * 3 + a1, b0 * 3 + b1)


def test_a_tree_beyond_all_bounds_is_refused():
    check_size(5, 4)
    with pytest.raises(InputError, match=r"4 moves with 9 choices .*4\.3e\+07"):
        check_size(9, 4)
