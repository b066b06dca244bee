"""Pairings: races of two competitors on one circuit, drawn beforehand so that any of them can be driven again.

Every set of races is one: of a tournament, of a study's table, for training, or out of a folder of results. There are
two ways to draw them:

- scheduled (:func:`schedule_pairing`): race ``k`` has the same start line, side and noise for every pair on a circuit;
- crossed (:func:`cross_pairing`): start policies of the ego times variants of the opponent, start lines and sides,
  20 x 20 x 5 x 2 = 4,000 games in the paper. Everything but the ego's decisions is the same for all egos against an
  opponent: start policies, opponents, lines, sides and noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.competitor import competitor_name
from pcs_racing.game.moves import move_names
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import Policy
from pcs_racing.race.races import start_lines
from pcs_racing.race.start_grid import Starts
from pcs_racing_agents.agents.agent import Competitor, as_competitor
from pcs_racing_agents.results.races import Categorical, RaceTable, narrow
from pcs_racing_agents.tournament.matches import Matches, game_between, play_games, variant_count
from pcs_racing_agents.tournament.schedule import Schedule

__all__ = ["Pairing", "cross_pairing", "schedule_pairing"]

LINE_SETS = 8  # a circuit has so many times the start lines that a pair of variants meets on


@dataclass(frozen=True, eq=False)
class Pairing:
    """N races of two competitors on one circuit.

    Attributes
    ----------
    game : RaceGame
        Circuit, archive and rules.
    ego, opponent : Competitor
        In car 0 and car 1.
    variants : ndarray, shape (N, 2), int64
        The policy of the archive that each starts with; for a driver which of its policies.
    starts : Starts
        N of them.
    noise : ndarray, shape (N,), uint64
        Keys of the races' noise.
    seed : int
        What all of this was drawn with.
    """

    game: RaceGame
    ego: Competitor
    opponent: Competitor
    variants: NDArray[np.int64]
    starts: Starts
    noise: NDArray[np.uint64]
    seed: int

    def __len__(self) -> int:
        return len(self.noise)

    @property
    def names(self) -> tuple[str, str]:
        """Names of ego and opponent."""
        return competitor_name(self.ego), competitor_name(self.opponent)

    def take(self, rows: ArrayLike) -> "Pairing":
        """Return some of the races, by their numbers."""
        chosen = np.asarray(rows)
        return replace(self, variants=self.variants[chosen], starts=self.starts.take(chosen), noise=self.noise[chosen])

    def one(self, race: int) -> dict[str, Any]:
        """Return what tells a race from the others: keywords of functions that drive a single game.

        Raises
        ------
        InputError
            If there is no such race.
        """
        if not 0 <= race < len(self):
            raise InputError(f"there is no race {race} in this pairing; there are races 0 to {len(self) - 1}")
        return {"policies": self.variants[race], "start": self.starts.take([race]), "seed": int(self.noise[race])}

    def play(self) -> Matches:
        """Drive the races."""
        return play_games(
            self.game, self.ego, self.opponent, policies=self.variants, starts=self.starts, seeds=self.noise
        )

    def table(self, matches: Matches) -> RaceTable:
        """Return what came of the races, in their order."""
        count, config = len(self), self.game.config
        return RaceTable(
            preset=Categorical.constant(config.race.name, count),
            agents=Categorical.concatenate([Categorical.constant(name, count) for name in self.names], axis=1),
            track=Categorical.constant(self.game.track.name, count),
            race=narrow(np.arange(count)),
            start_s=self.starts.s,
            side=narrow(self.starts.side),
            seed=Categorical.constant(str(self.seed), count),
            lead=matches.lead,
            winner=matches.winner,
            crash=matches.crash.max(axis=1),
            fault=matches.fault,
            overtakes=narrow(matches.overtakes),
            duration=matches.duration,
            variants=narrow(self.variants),
            path=narrow(matches.policy),
            moves=Categorical(move_names(self.game.archive, config.epsilon, True), narrow(matches.moves)),
        )


def schedule_pairing(game: RaceGame, ego: Competitor, opponent: Competitor, schedule: Schedule, seed: int) -> Pairing:
    """Return the races of a schedule for two competitors; ``seed`` is what it was drawn with."""
    variants = schedule.variants(variant_count(game, ego), variant_count(game, opponent))
    return Pairing(game, ego, opponent, variants, schedule.starts, schedule.seeds, seed)


def cross_pairing(
    game: RaceGame,
    ego: Competitor | Policy,
    opponent: Competitor | Policy,
    *,
    egos: int | Sequence[int] = 20,
    opponents: int | Sequence[int] = 20,
    lines: int = 5,
    seed: int = 0,
) -> Pairing:
    """Draw races in which every ego variant meets every opponent variant, on several lines, from both sides.

    Parameters
    ----------
    game : RaceGame
        Circuit, archive and rules.
    ego, opponent : Agent, Driver, Policy, or object with ``predict`` or ``decide``
        "never-switch" is the paper's non-GT agent, "random-policy" its random one, "lane-switcher" its unseen one. Only
        how many variants they have plays a role for what is drawn: all agents drive the same races.
    egos, opponents : int or sequence of int
        How many variants, drawn without repetition (all of them, where there are no more); or which.
    lines : int
        Start lines of each pair of variants, 1 to 1000; drawn from eight times as many.
    seed : int
        The same for pairings that are to be compared.

    Raises
    ------
    InputError
        If a competitor does not fit the game, a number is impossible, a variant does not exist, or the track has no
        place to start.
    """
    cars = (as_competitor(ego), as_competitor(opponent))
    arena = game_between(game, *cars)
    if isinstance(lines, bool) or not isinstance(lines, int) or not 1 <= lines <= 1000:
        raise InputError(f"lines is {lines!r}; it must be a whole number from 1 to 1000")
    race_seeds(seed, 1)  # checks the seed
    first = _variants("egos", egos, variant_count(arena, cars[0]), seed, 3)
    second = _variants("opponents", opponents, variant_count(arena, cars[1]), seed, 4)
    rules = replace(arena.setup.config, start_lines=lines * LINE_SETS)
    where = start_lines(arena.track, rules, np.random.SeedSequence(seed, spawn_key=(0,)))
    grid = np.meshgrid(first, second, np.arange(lines), np.arange(2), indexing="ij")
    a, b, own_line, side = (axis.reshape(-1).astype(np.int64) for axis in grid)
    pairs = len(first) * len(second)
    # Were the lines the same for all pairs, their luck would not average out, however many pairs there are.
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(5,)))
    rounds = [generator.permutation(lines * LINE_SETS) for _ in range(-(-pairs // LINE_SETS))]
    line = np.concatenate(rounds)[np.repeat(np.arange(pairs), 2 * lines) * lines + own_line]
    return Pairing(
        game, *cars, np.stack([a, b], axis=1), Starts(where[line], side), race_seeds(seed, len(line)), int(seed)
    )


def _variants(what: str, wanted: int | Sequence[int], available: int, seed: int, stream: int) -> NDArray[np.int64]:
    if isinstance(wanted, int | np.integer) and not isinstance(wanted, bool):
        if wanted < 1:
            raise InputError(f"{what} is {wanted}; a pairing needs at least one variant")
        generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream,)))
        return np.sort(generator.permutation(available)[: int(wanted)])
    chosen = np.asarray(wanted)
    if chosen.ndim != 1 or len(chosen) == 0 or chosen.dtype.kind not in "iu" or len(set(chosen.tolist())) < len(chosen):
        raise InputError(f"{what} is {wanted!r}; it must be a number of variants, or a list of different ones")
    if chosen.min() < 0 or chosen.max() >= available:
        raise InputError(f"{what} are {wanted!r}; there are variants 0 to {available - 1}")
    return chosen.astype(np.int64)
