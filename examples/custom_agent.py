"""Race own agents in a tournament: a strategy, an object with ``act``, a registered name.

    python examples/custom_agent.py
    python examples/custom_agent.py --track Saltmere --races 200

The strategy reads two features of the observation: the lead and the measured driving style of the
opponent.
"""

import argparse
from dataclasses import dataclass

import numpy as np

from pcs_racing import load_track, make_game
from pcs_racing.game import RaceGame
from pcs_racing_agents.agents import Agent, observing, register_agent
from pcs_racing_agents.tournament import play_tournament, show_progress


# 1. A strategy: probabilities of the moves (B, M) for observations (B, D). A dataclass can be sent
# to other processes.
@dataclass(frozen=True)
class CatchUp:
    """Raise aggressiveness behind a restrained opponent, and restraint in the lead; else stay."""

    moves: tuple[str, ...]

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Return the probabilities of the moves."""
        step = observing.moves_made(observation, axes=2)
        lead = observation[np.arange(len(observation)), 6 * step + 4]  # the element lead_k, in 20 m
        # the opponent's aggressiveness and restraint, measured over 8 s
        opponent = observing.opponent(observation, axes=2)
        wanted = np.full(len(observation), self.moves.index("stay"))
        wanted[(lead < 0.0) & (opponent[:, 1] > 0.5)] = self.moves.index("aggressiveness +")
        wanted[lead > 0.25] = self.moves.index("restraint +")
        return np.eye(len(self.moves))[wanted]


def catch_up(spec: RaceGame, *, name: str = "catch-up", seed: int = 0) -> Agent:
    """Raise aggressiveness behind a restrained opponent, and restraint in the lead."""
    return Agent(name, CatchUp(spec.moves), spec, seed)


# 2. Any object with `act`. `turn.memories` holds one value for each game, None at its start.
class Stubborn:
    """Repeats its first move, chosen by the lead after the first step."""

    name = "stubborn"

    def act(self, observations, turn):
        """Return the moves; the memories of the first turn are the moves of all turns."""
        for i, first_move in enumerate(turn.memories):
            if first_move is None:
                turn.memories[i] = 0 if observations[i, 4] < 0.0 else 2
        return turn.memories


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--track", default="Tarnfjord", help="name of a shipped track or a map folder"
    )
    parser.add_argument("--rules", default="contest", help="rules: paper, contest or a YAML file")
    parser.add_argument("--races", type=int, default=60, help="races of each pair, even")
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of start lines, start policies and noise"
    )
    arguments = parser.parse_args()

    rules = arguments.rules
    mine = catch_up(make_game(None, "default", rules))

    # 3. A registered agent has a name, like the agents of the zoo. An installed package declares it
    #    as an entry point "pcs_racing.agents" instead, also for the command line.
    register_agent("catch-up-too", catch_up)

    entrants = [mine, "catch-up-too", Stubborn(), "never-switch", "random-moves"]
    tournament = play_tournament(
        load_track(arguments.track),
        entrants,
        rules,
        races_per_pair=arguments.races,
        seed=arguments.seed,
        progress=show_progress(),
    )
    print(tournament)


if __name__ == "__main__":
    main()
