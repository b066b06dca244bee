import pytest

from pcs_racing import make_game
from pcs_racing_agents.agents import make_setting
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.study.highlights import ExplainedRace, select_highlights, watch_race
from pcs_racing_agents.tournament.pairings import cross_pairing
from pcs_racing_agents.tournament.runner import play_pairing


@pytest.fixture(scope="session")
def raced(oval, archive):
    """A pairing of an agent, its races, and those of the agent that never switches."""
    game = make_game(oval, archive, "contest", step_seconds=0.8)
    setting = make_setting(archive, game.config)
    agent, base, rival = (build(name, setting) for name in ("random-moves", "never-switch", "lane-switcher"))
    pairings = [cross_pairing(game, arm, rival, egos=4, opponents=4, lines=2, seed=3) for arm in (agent, base)]
    return pairings[0], *map(play_pairing, pairings)


@pytest.fixture(scope="session")
def watched(raced) -> ExplainedRace:
    pairing, ours, baseline = raced
    title, race = next(iter(select_highlights(ours, baseline).values()))
    return watch_race(pairing, race, title)
