"""What a step of driving pays, and who has won: the compiled forms, against numbers by hand."""

import pytest

from pcs_racing.game.reward import step_reward, win_sign
from pcs_racing.race.config import load_race_config
from pcs_racing.race.races import TIE_WITHIN, winners
from pcs_racing.race.state import empty_state


def plain(function):
    """A function for kernels as Python."""
    return getattr(function, "py_func", function)


def test_the_winner_is_ahead_and_a_step_pays_progress_less_the_opponents_share():
    for lead, sign in [(3.0, 1.0), (-3.0, -1.0), (0.9 * TIE_WITHIN, 0.0), (-TIE_WITHIN, 0.0)]:
        assert [plain(win_sign)(lead, False, 0, 0, loses) for loses in (True, False)] == [
            sign,
            sign,
        ]
    weights = (2.0, 0.5, 7.0)
    assert plain(step_reward)(1.0, 0.4, 0, weights) == pytest.approx(2.0 * (1.0 - 0.2))
    assert plain(step_reward)(1.0, 0.4, 1, weights) == pytest.approx(2.0 * (1.0 - 0.2) - 7.0)
    # The compiled rule is that of :func:`pcs_racing.race.races.winners`, from either side.
    for rule in ("nobody", "fault-loses"):
        config = load_race_config("paper", crash_rule=rule)
        for lead in (-3.0, 0.0, 0.005, 2.0):
            for crash, fault in (
                ((0, 0), (0, 0)),
                ((1, 0), (1, 0)),
                ((2, 2), (0, 1)),
                ((1, 1), (1, 1)),
            ):
                state = empty_state(1, 0)
                state.progress[0], state.crash[0], state.fault[0] = (lead, 0.0), crash, fault
                winner = winners(config, state)[0]
                for car in range(2):
                    ahead = lead if car == 0 else -lead
                    sign = plain(win_sign)(
                        ahead, crash != (0, 0), fault[car], fault[1 - car], rule != "nobody"
                    )
                    assert sign == (0.0 if winner < 0 else 1.0 if winner == car else -1.0)
