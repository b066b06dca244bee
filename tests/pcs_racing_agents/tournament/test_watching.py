import numpy as np
import pytest

from pcs_racing import CONTEST, InputError, make_game
from pcs_racing.base.seeds import race_seeds
from pcs_racing.race.races import draw_starts
from pcs_racing_agents.agents import make_setting
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.tournament.games import play_games
from pcs_racing_agents.tournament.watching import record_game


@pytest.mark.parametrize(
    "pair",
    [("random-moves", "always-aggressiveness+"), ("random-moves", "lane-switcher"), ("pure-pursuit", "random-moves")],
)
def test_a_recorded_game_is_the_game(oval, archive, pair):
    game = make_game(oval, archive, CONTEST, step_seconds=0.8)
    ego, opponent = (build(name, make_setting(archive, game.config)) for name in pair)
    starts, seeds = draw_starts(oval, game.setup.config, 4, 1), race_seeds(2, 4)
    variants = np.array([[0, 3]] * 4) if pair[0] == "pure-pursuit" else np.array([[2, 3], [9, 1], [4, 4], [11, 0]])
    played = play_games(game, ego, opponent, policies=variants, starts=starts, seeds=seeds)
    for i in range(4):
        replay, again, _ = record_game(
            game, ego, opponent, policies=variants[i], start=starts.take([i]), seed=int(seeds[i]), candidates=False
        )
        assert replay.lead[-1] == played.lead[i] == again.lead[0]
        assert replay.duration == pytest.approx(played.duration[i], abs=0.04)
        assert ("crash" in replay.outcome) == played.crash[i].any()
        assert replay.car_names == pair
    with pytest.raises(InputError, match=r"policies .*\(1, 2\)"):
        record_game(game, ego, opponent, policies=variants[:1], start=starts.take([0]), seed=1)
