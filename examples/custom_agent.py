"""An agent of your own in a tournament: it looks at the lead and at how the opponent drives, and
decides.

    python examples/custom_agent.py
    python examples/custom_agent.py --track Saltmere --races 200

Three ways to bring one: a function from observations to chances of the moves, any object with
``act``, and an agent registered under a name.
"""

import argparse
from dataclasses import dataclass

import numpy as np

from pcs_racing import load_track
from pcs_racing_agents.agents import Agent, GameSpec, make_game_spec, observing, register_agent
from pcs_racing_agents.tournament import game_rules, play_tournament, show_progress, tournament_text


# 1. A strategy: chances of the moves (B, M) for observations (B, D). A dataclass can be sent to
# other processes.
@dataclass(frozen=True)
class CatchUp:
    """Bold behind a restrained opponent, careful in front, and else as it is."""

    moves: tuple[str, ...]

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Chances of the moves."""
        step = observing.moves_made(observation, axes=2)
        lead = observation[np.arange(len(observation)), 6 * step + 4]  # the element lead_k, in 20 m
        # its aggressiveness and restraint, measured on 8 s
        opponent = observing.opponent(observation, axes=2)
        wanted = np.full(len(observation), self.moves.index("stay"))
        wanted[(lead < 0.0) & (opponent[:, 1] > 0.5)] = self.moves.index("aggressiveness +")
        wanted[lead > 0.25] = self.moves.index("restraint +")
        return np.eye(len(self.moves))[wanted]


def catch_up(spec: GameSpec, *, name: str = "catch-up", seed: int = 0) -> Agent:
    """Bold behind a restrained opponent, careful in front."""
    return Agent(name, CatchUp(spec.moves), spec, seed)


# 2. Any object with act. It may remember: the turn has a value of its own for each game.
class Stubborn:
    """Repeats the move that it made first, which depends on the lead after the first step."""

    name = "stubborn"

    def act(self, observations, turn):
        """Return the moves, and keep them for the next turn."""
        for i, first_move in enumerate(turn.memories):
            if first_move is None:
                turn.memories[i] = 0 if observations[i, 4] < 0.0 else 2
        return turn.memories


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--track", default="Tarnfjord", help="name of a shipped circuit or a map folder"
    )
    parser.add_argument(
        "--rules", default="contest", help="rules of the race: paper, contest or a YAML file"
    )
    parser.add_argument("--races", type=int, default=60, help="races of each pair, even")
    parser.add_argument(
        "--seed", type=int, default=0, help="root of start lines, start policies and noise"
    )
    arguments = parser.parse_args()

    rules = game_rules(arguments.rules)
    mine = catch_up(make_game_spec("default-early", rules))

    # 3. Under a name it can be asked for like the others; a distribution declares it in the entry
    #    points "pcs_racing.agents" instead, and then the command line knows it, too.
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
    print(tournament_text(tournament))


if __name__ == "__main__":
    main()
