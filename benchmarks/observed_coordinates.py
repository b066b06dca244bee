"""What a player learns of its opponent that the lead does not tell already: R2 of observed coordinates on the lead.

    python benchmarks/observed_coordinates.py      # both archives on two circuits each, random moves; a minute

In every step of a game a player sees the opponent's coordinates, as measured in that step alone, and the lead. Each
coordinate is regressed on the leads at the end of this step and of the one before (ordinary least squares with an
intercept); R2 = 1 says that whoever sees the lead knows the coordinate. Observations that the environment clips are
left out. The last column is the correlation of the two axes over the policies of the archive.
"""

import argparse

import numpy as np

from pcs_racing import make_game
from pcs_racing.game.rules import RaceGame

GAMES = {
    "paper": ("default", ("Tarnfjord", "Brackwater")),
    "contest": ("contest", ("Pipkin", "Larkmoor")),
}


def observations(game: RaceGame, games: int, seed: int) -> np.ndarray:
    """What both players saw at the end of games of random moves, shape (2 * games, D)."""
    rng = np.random.default_rng(seed)
    state = game.reset(games=games, seed=seed)
    while not game.done(state).all():
        state = game.step(state, rng.integers(len(game.move_names), size=(games, 2)))
    return game.observation(state).reshape(2 * games, -1).astype(np.float64)


def r_squared(game: RaceGame, seen: np.ndarray, axis: str) -> tuple[float, int]:
    """R2 of the opponent's coordinate on the two leads, over all steps after the first, and how many observations."""
    elements = game.observation_elements
    places = {element.name: i for i, element in enumerate(elements)}
    x, y = [], []
    for step in range(1, game.config.moves + 1):
        names = (f"lead_{step - 1}", f"lead_{step}", f"opponent_{axis}_{step}")
        at = [places[name] for name in names]
        low, high = (np.array([getattr(elements[i], bound) for i in at]) for bound in ("low", "high"))
        known = seen[:, places[f"seen_{step}"]] > 0.5
        inside = ((seen[:, at] > low + 1e-6) & (seen[:, at] < high - 1e-6)).all(axis=1)
        found = seen[known & inside][:, at]
        x.append(found[:, :2])
        y.append(found[:, 2])
    leads, values = np.concatenate(x), np.concatenate(y)
    design = np.column_stack([np.ones(len(leads)), leads])
    rest = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    return 1.0 - float(rest @ rest) / float(((values - values.mean()) ** 2).sum()), len(values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--games", type=int, default=1000, help="games on each circuit")
    parser.add_argument("--seed", type=int, default=9_000_000, help="root of starts, noise and moves")
    arguments = parser.parse_args()
    print("| race | circuit | opponent's coordinate | observations | R2 on the lead | correlation of the axes |")
    print("|---|---|---|---|---|---|")
    for race, (archive, tracks) in GAMES.items():
        for track in tracks:
            game = make_game(track, archive, race)
            axes = game.archive.characteristics
            together = float(np.corrcoef(game.archive.coordinates.T)[0, 1])
            seen = observations(game, arguments.games, arguments.seed)
            for axis in axes:
                value, number = r_squared(game, seen, axis)
                print(f"| {race} | {track} | {axis} | {number} | {value:.3f} | {together:+.3f} |", flush=True)


if __name__ == "__main__":
    main()
