"""The agent that only remembers: what it replies to what it saw, and the table that it looks it up
in.
"""

import numpy as np
import pytest

from pcs_racing import InputError, make_game
from pcs_racing.envs.match import MatchVectorEnv
from pcs_racing_agents.agents import make_game_spec
from studies.matches.behaviours import Behaviours, save_behaviours
from studies.matches.remember import MatchAgent, remember

POLICIES = 3  # the rivals that are made up; policy 3 is the best one on average


def made_up_behaviours(spec) -> Behaviours:
    """Return opponents with first coordinates 0, 0.5 and 1; the best reply to opponent j is policy
    j.
    """
    policies, width = len(spec.archive), len(spec.archive.characteristics) + 2
    seen = np.zeros((policies, POLICIES, width))
    seen[:, :, 0] = np.linspace(0.0, 1.0, POLICIES)
    seen[:, :, -1] = 1.0
    scores = np.full((policies, POLICIES), 0.4)
    scores[np.arange(POLICIES), np.arange(POLICIES)] = 0.9
    scores[POLICIES] = 0.6  # best on average, best against no opponent
    names = tuple(f"rival {j}" for j in range(POLICIES))
    game = spec.identity._replace(elements=(), moves=())
    return Behaviours(game, names, scores, seen, 0.01 * np.eye(width))


@pytest.fixture(scope="module")
def table(spec) -> Behaviours:
    return made_up_behaviours(spec)


def observed(spec, *races, left=1):
    """What a player knows of a match: (own policy, opponent's first coordinate) of each race that
    is over.
    """
    blocks = []
    for own, coordinate in races:
        blocks += [*spec.archive.normalised[own], coordinate, 0.0, 0.0, 0.0, 1.0]
    blocks += [0.0] * (7 * left)
    return np.array([*blocks, left / (len(races) + left), 1.0], np.float32)


@pytest.fixture(scope="module")
def agent(spec, table) -> MatchAgent:
    return remember(spec, table=table)


def test_without_knowledge_it_drives_the_best_fixed_policy(agent, spec):
    assert agent.choose(observed(spec, left=3)[None]).tolist() == [POLICIES]
    assert agent.choice.table.best_fixed == POLICIES


@pytest.mark.parametrize("rival", range(POLICIES))
@pytest.mark.parametrize("reply", ["likely", "nearest"])
def test_it_replies_to_the_behaviour_that_it_saw(spec, table, rival, reply):
    agent = remember(spec, table=table, reply=reply)
    coordinate = rival / 2.0 + 0.1
    assert agent.choose(observed(spec, (POLICIES, coordinate), left=2)[None]).tolist() == [rival]


def test_between_two_behaviours_the_likely_reply_is_to_both(spec, table):
    half = observed(spec, (3, 0.25), left=2)[None]
    # .65 against both halves; the first of two
    assert remember(spec, table=table).choose(half).tolist() == [0]
    safe = np.array(table.scores)
    safe[4, :2] = 0.7
    cautious = Behaviours(table.game, table.opponents, safe, table.seen, table.covariance)
    assert remember(spec, table=cautious).choose(half).tolist() == [4]
    slightly = observed(spec, (3, 0.24), left=2)[None]
    assert remember(spec, table=cautious, reply="nearest").choose(slightly).tolist() == [0]


def test_it_is_an_opponent_of_a_match(spec, table, oval):
    opponent = remember(spec, table=table)
    envs = MatchVectorEnv(4, track=oval, archive=spec.archive, race=spec.config, opponent=opponent)
    envs.reset(seed=1)
    assert (envs.step(np.array([0, 5, 8, 11]))[4]["race"] == 1).all()
    assert envs.batch.played.policy[:, 1].tolist() == [POLICIES] * 4


def test_its_table_is_a_folder_for_this_game(spec, table, archive, tmp_path):
    folder = save_behaviours(table, tmp_path / "behaviours")
    assert remember(spec, table=folder).content_hash == remember(spec, table=table).content_hash
    other = make_game("Pipkin", archive, moves=2).config
    with pytest.raises(InputError, match="games of 4 moves"):
        remember(make_game_spec(archive, other), table=folder)
