"""What games of moves cost beside the races themselves, one thread.

python benchmarks/game_speed.py
"""

import time
from dataclasses import replace

import numpy as np

from pcs_racing import make_game
from pcs_racing.base.seeds import race_seeds
from pcs_racing.race.races import advance, draw_starts, start_races
from pcs_racing_agents.agents import make
from pcs_racing_agents.tournament import play_games

GAMES = 200


def main() -> None:
    game = replace(make_game("Tarnfjord", stay=True), threads=1)
    rng = np.random.default_rng(0)
    policies = rng.integers(0, len(game.archive), (GAMES, 2))
    given = {
        "policies": policies,
        "starts": draw_starts(game.track, game.setup.config, GAMES, 1),
        "seeds": race_seeds(2, GAMES),
    }
    never, walker = make("never-switch"), make("best-fixed", target=0)
    play_games(game, never, walker, **given)
    noise = game.reset(given["seeds"], policies=policies, starts=given["starts"]).race.seed
    rounds = []
    for _ in range(3):
        begin = time.perf_counter()
        played = play_games(game, never, never, **given)
        middle = time.perf_counter()
        state = start_races(game.setup, given["starts"], noise)
        theta = np.ascontiguousarray(game.theta(policies))
        advance(game.setup, state, theta, game.setup.config.ticks, threads=1)
        rounds.append((middle - begin, time.perf_counter() - middle))
        np.testing.assert_array_equal(state.lead, played.lead)  # the very same races
    game_time, race = (1e3 * min(column) / GAMES for column in zip(*rounds, strict=True))
    print(
        f"{GAMES} games of 40 s: {game_time:.2f} ms a game; the same races without the game {race:.2f} ms; "
        f"{game_time / race - 1.0:.1%} more"
    )


if __name__ == "__main__":
    main()
