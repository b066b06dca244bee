"""What a step of driving pays, and who has won: the compiled forms, against numbers by hand."""

import numpy as np
import pytest

from pcs_racing.game.reward import step_reward, win_sign
from pcs_racing.race.races import TIE_WITHIN


def plain(function):
    """A function for kernels as Python."""
    return getattr(function, "py_func", function)


def test_a_step_pays_progress_less_the_opponents_share_and_the_penalty():
    weights = (2.0, 0.5, 7.0)
    assert plain(step_reward)(1.0, 0.4, 0, weights) == pytest.approx(2.0 * (1.0 - 0.2))
    assert plain(step_reward)(1.0, 0.4, 1, weights) == pytest.approx(2.0 * (1.0 - 0.2) - 7.0)


@pytest.mark.parametrize(("lead", "sign"), [(3.0, 1.0), (-3.0, -1.0), (0.9 * TIE_WITHIN, 0.0), (-TIE_WITHIN, 0.0)])
def test_without_a_crash_the_car_ahead_has_won(lead, sign):
    assert [plain(win_sign)(lead, False, 0, 0, loses) for loses in (True, False)] == [sign, sign]


@pytest.mark.parametrize("lead", [-3.0, 3.0])
def test_after_a_crash_the_rules_say_whether_the_car_at_fault_has_lost(lead):
    faults = [(0, 0), (1, 0), (0, 1), (1, 1)]
    assert [plain(win_sign)(lead, True, *fault, True) for fault in faults] == [0.0, -1.0, 1.0, 0.0]
    assert not np.any([plain(win_sign)(lead, True, *fault, False) for fault in faults])
