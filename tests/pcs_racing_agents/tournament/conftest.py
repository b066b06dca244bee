import numpy as np
import pytest

from pcs_racing import load_rules, load_track, make_game, racer
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.players import competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.races import draw_starts
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.tournament import Pairing, Tournament, play_tournament

CONTEST = load_rules("contest", duration=6.0)
POLICIES = [racer(f"lattice:pace={pace}") for pace in (0.0, 0.5, 1.0)]
MIXED = ["random-moves", "best-fixed:target=3", "lane-switcher:any", POLICIES[1]]
GAMES = 12


@pytest.fixture(scope="session")
def contest(oval, archive) -> RaceGame:
    """Games with short steps, so disturbed that some end in a crash."""
    return make_game(oval, archive, load_rules("contest", steering_noise=0.1), steps=(0.8,) * 5)


@pytest.fixture(scope="session")
def zoo(contest) -> dict:
    spec = make_game(None, contest.archive, contest.rules)
    names = ("random-moves", "never-switch", "random-policy", "pure-pursuit", "lane-switcher:any")
    return {name: build(name, spec) for name in names}


@pytest.fixture(scope="session")
def starts(contest) -> Starts:
    return draw_starts(contest.track, contest.setup.rules, GAMES, 5)


@pytest.fixture(scope="session")
def games_of(contest, starts):
    """Twelve games of two competitors from the same starts, as a pairing."""

    def pairing(ego, opponent) -> Pairing:
        ego, opponent = competitor(ego, contest), competitor(opponent, contest)
        variants = np.random.default_rng(3).integers(0, 12, (GAMES, 2))
        for car, player in enumerate((ego, opponent)):
            # a fixed policy may have one variant
            variants[:, car] %= len(getattr(player, "policies", range(12)))
        return Pairing(contest, ego, opponent, variants, starts, race_seeds(6, GAMES), 0)

    return pairing


@pytest.fixture(scope="session")
def tournament(oval) -> Tournament:
    return play_tournament(
        [oval, load_track("Pipkin")], POLICIES, CONTEST, races_per_pair=6, seed=4
    )


@pytest.fixture(scope="session")
def mixed(oval, archive) -> Tournament:
    """Agents, a fixed policy with variants, and a policy."""
    return play_tournament(oval, MIXED, CONTEST, archive=archive, races_per_pair=8, seed=1)
