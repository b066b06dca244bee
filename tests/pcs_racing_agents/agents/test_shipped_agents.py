"""Every agent of the zoo races with its defaults, with both shipped archives."""

import numpy as np
import pytest

import pcs_racing_agents
from pcs_racing import UnknownNameError, make_game
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents.zoo import entries
from pcs_racing_agents.tournament import play_games
from pcs_racing_agents.tournament.games import variant_count

GAMES = (("default", "paper", "Tarnfjord"), ("contest", "contest", "Brackwater"))


@pytest.mark.parametrize(("archive", "race", "track"), GAMES)
def test_every_name_that_is_offered_races(archive, race, track):
    game = make_game(track, archive, race, threads=1)
    starts, seeds = Starts(game.start_lines[:2], np.array([0, 1])), np.array([7, 8], np.uint64)
    rival = pcs_racing_agents.make("never-switch", archive=archive, race=race)
    for name in pcs_racing_agents.names(archive, race):
        try:
            agent = pcs_racing_agents.make(name, archive=archive, race=race)
        except UnknownNameError:
            # Made by a study, and shipped when there is one.
            assert name == "ppo" or entries()[name].needs == "networks", name
            continue
        policies = np.array([[3, 5], [5, 3]]) % variant_count(game, agent)
        played = play_games(game, agent, rival, policies=policies, starts=starts, seeds=seeds)
        again = play_games(game, agent, rival, policies=policies[:1], starts=starts.take([0]), seeds=seeds[:1])
        assert played.lead[0] == again.lead[0], name
