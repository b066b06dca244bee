"""Explain a race between two agents: observations, moves and their probabilities.

    python examples/explain_a_race.py
    python examples/explain_a_race.py --track Brackwater --ego response --seed 3 --wait

The race advances by one pair of moves at a time. At the end the same race is written as a replay
page with the moves marked. ``pcs-racing view --explain`` explains a race of a results folder.
"""

import argparse
from pathlib import Path

import numpy as np

from pcs_racing import make_game, save_replay
from pcs_racing.game import draw_starts, race_seeds
from pcs_racing_agents import make, watch
from pcs_racing_agents.agents import observing
from pcs_racing_agents.tournament import Pairing, repeat_race


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--track", default="Tarnfjord", help="name of a shipped track or a map folder"
    )
    parser.add_argument("--rules", default="paper", help="rules: paper, contest or a YAML file")
    parser.add_argument("--archive", default="default", help="archive that the agents move in")
    parser.add_argument("--ego", default="cfr-argmax", help="agent in car 0")
    parser.add_argument("--opponent", default="never-switch", help="agent in car 1")
    parser.add_argument(
        "--seed", type=int, default=3, help="seed of start, start policies and noise"
    )
    parser.add_argument("--wait", action="store_true", help="wait for Enter before each move")
    parser.add_argument(
        "--out", type=Path, default=Path("out/explain_a_race"), help="folder of the page"
    )
    arguments = parser.parse_args()

    game = make_game(arguments.track, arguments.archive, arguments.rules, stay=True)
    names = (arguments.ego, arguments.opponent)
    cars = [
        make(name, archive=arguments.archive, rules=arguments.rules, seed=arguments.seed)
        for name in names
    ]
    axes = len(game.archive.characteristics)

    # 1. A race drawn by the seed; both cars drive their start policies for a step, without moves.
    first = np.random.default_rng(arguments.seed).integers(len(game.archive), size=2)
    start = draw_starts(game.track, game.setup.rules, 1, arguments.seed)
    key = race_seeds(arguments.seed, 1)  # seeds of the noise
    state = game.reset(key, policies=first, starts=start)
    print(
        f"{names[0]} (policy {first[0]}) against {names[1]} (policy {first[1]}) on"
        f" {game.track.name}"
    )

    # 2. A pair of moves for each step, until the race is over.
    while not game.done(state)[0]:
        if arguments.wait:
            input("Enter: next move ")
        observations = game.observation(state)  # (1, 2, D): an observation for each car
        point = observing.opponent(observations[:, 0], axes)[0]
        about = ", ".join(
            f"{name} {value:.2f}"
            for name, value in zip(game.archive.characteristics, point, strict=True)
        )
        moves = [int(car.act(observations[:, i])[0]) for i, car in enumerate(cars)]
        chances = cars[0].probabilities(observations[:, 0])[0]
        before = state.leads[0, state.step[0]]
        state = game.step(state, np.array([moves]))
        made = [game.moves[move] for move in moves]
        print(f"move {int(state.step[0])}: lead {before:+.1f} m; measured opponent: {about}")
        chance, policy = chances[moves[0]], state.policy[0, 0]
        print(
            f"  ego: {made[0]} (probability {chance:.0%}), now policy {policy}; opponent: {made[1]}"
        )

    # 3. The same race again, recorded.
    recording = repeat_race(Pairing(game, *cars, first[None], start, key), 0)
    assert recording.played.lead[0] == state.race.lead[0]  # identical
    print(recording.replay.outcome)
    replay = watch.mark_moves(recording.replay, recording.played, game.moves, game.rules.ends)
    arguments.out.mkdir(parents=True, exist_ok=True)
    print("page:", save_replay(replay, arguments.out / "race.html"))


if __name__ == "__main__":
    main()
