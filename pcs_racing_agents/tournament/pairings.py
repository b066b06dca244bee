"""Pairings: sets of races of two competitors on one circuit, drawn in advance so that any race can be repeated.

Tournaments, the tables of studies, training races and folders of results consist of pairings. There are two designs:

- scheduled (:func:`schedule_pairing`): race ``k`` has the same start line, side and noise for every pair on a circuit;
- crossed (:func:`cross_pairing`): start policies of the ego times variants of the opponent, start lines and sides,
  20 x 20 x 5 x 2 = 4,000 games in the paper. For all egos against an opponent everything but the ego's decisions is
  the same: start policies, variants of the opponent, lines, sides and noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.checks import check_whole, check_whole_array, is_whole
from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.competitor import competitor_name
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import Policy
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.races import draw_starts, start_lines
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.track import Track
from pcs_racing_agents.agents.agent import Competitor, as_competitor
from pcs_racing_agents.base.chunks import Arrays
from pcs_racing_agents.tournament.games import game_between, race_columns, variant_count

MOST_RACES = 2000


class RaceSchedule(NamedTuple):
    """Races of one pair on one track; the same for all pairs (common random numbers)."""

    starts: Starts  #: N of them; races 2j and 2j + 1 start on the same line, from either side.
    #: shape (N, 2): Random numbers that select the variants of ego and opponent. Races 2j and 2j + 1 swap them with the
    #: sides, so that the advantage of a side is equal for both competitors.
    draws: NDArray[np.uint64]
    seeds: NDArray[np.uint64]  #: shape (N,): Keys of the noise.

    def variants(self, ego: int, opponent: int) -> NDArray[np.int64]:
        """Return the variants in each race, shape (N, 2), from the numbers of variants of ego and opponent."""
        return (self.draws % np.array([ego, opponent], np.uint64)).astype(np.int64)


def draw_schedule(track: Track, config: RaceConfig, races: int, seed: int) -> RaceSchedule:
    """Draw the races of each pair on a track.

    ``config``: its ``start_lines`` is not used: every two races draw a line of their own. ``races``: even, from 2 to
    2000.
    """
    if not is_whole(races) or races % 2 or not 2 <= races <= MOST_RACES:
        raise InputError(
            f"races_per_pair is {races!r}; it must be an even number from 2 to {MOST_RACES}, since every start line is "
            "driven from both sides"
        )
    starts = draw_starts(track, replace(config, start_lines=races // 2), races, seed)
    # Large numbers, of which the remainder selects a variant: a schedule is drawn before anybody knows who races, and
    # pairs with equally many variants start alike.
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2,)))
    draws = generator.integers(2**63, size=(races // 2, 2), dtype=np.uint64)
    swapped = np.stack([draws, draws[:, ::-1]], axis=1).reshape(races, 2)
    return RaceSchedule(starts, swapped, race_seeds(seed, races))


LINE_SETS = 8  # start lines on a circuit, as a multiple of those of one pair of variants


@dataclass(frozen=True, eq=False)
class Pairing:
    """N races of two competitors on one circuit."""

    game: RaceGame  #: Circuit, archive and rules.
    ego: Competitor  #: ``ego``, ``opponent``: In car 0 and car 1.
    opponent: Competitor
    #: shape (N, 2): The policy of the archive that each starts with; for a driver which of its policies.
    variants: NDArray[np.int64]
    starts: Starts  #: N of them.
    noise: NDArray[np.uint64]  #: shape (N,): Keys of the races' noise.
    seed: int  #: Seed of the draws of all of this.

    def __len__(self) -> int:
        return len(self.noise)

    @property
    def names(self) -> tuple[str, str]:
        """Names of ego and opponent."""
        return competitor_name(self.ego), competitor_name(self.opponent)

    def take(self, rows: ArrayLike) -> "Pairing":
        """Return some of the races, by their numbers."""
        indices = np.asarray(rows)
        return replace(
            self, variants=self.variants[indices], starts=self.starts.take(indices), noise=self.noise[indices]
        )

    def race_arguments(self, race: int) -> dict[str, Any]:
        """Return the variants, start and seed of a race: keyword arguments of functions that simulate a single game."""
        if not 0 <= race < len(self):
            raise InputError(f"there is no race {race} in this pairing; there are races 0 to {len(self) - 1}")
        return {"policies": self.variants[race], "start": self.starts.take([race]), "seed": int(self.noise[race])}

    def race(self, egos: Sequence[Competitor]) -> list[Arrays]:
        """Drive the races with each of several egos; see :func:`pcs_racing_agents.tournament.games.race_columns`."""
        return race_columns(self.game, egos, self.opponent, self.variants, self.starts, self.noise)


class RaceBlock(NamedTuple):
    """Some races of a group of pairings, which differ in nothing but their egos."""

    content_hash: str  #: Hash of everything that their result depends on.
    group: int  #: Number of the group.
    first: int  #: ``first``, ``last``: The races of each pairing from ``first`` to before ``last``.
    last: int


def race_block(groups: Sequence[Sequence[Pairing]], observations: bool, block: RaceBlock) -> Arrays:
    """Drive a block of races: arrays by name, whose first axis is that of the egos; observations only if wanted."""
    group = groups[block.group]
    raced = group[0].take(np.arange(block.first, block.last)).race([pairing.ego for pairing in group])
    left_out = {"noise"} if observations else {"noise", "observations"}
    return {name: np.stack([own[name] for own in raced]) for name in raced[0] if name not in left_out}


def schedule_pairing(
    game: RaceGame, ego: Competitor, opponent: Competitor, schedule: RaceSchedule, seed: int
) -> Pairing:
    """Return the races of a schedule for two competitors; ``seed`` is that of the schedule."""
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
    """Draw races of every ego variant against every opponent variant, on several lines, from both sides.

    Parameters
    ----------
    ego, opponent : Agent, Driver, Policy, or object with ``predict`` or ``decide``
        "never-switch" is the paper's non-GT agent, "random-policy" its random one, "lane-switcher" its unseen one. The
        draws depend on the numbers of their variants only: all agents drive the same races.
    egos, opponents : int or sequence of int
        Number of variants, drawn without repetition (all of them, if there are no more), or a list of variants.
    lines : int
        Start lines of each pair of variants, 1 to 1000; drawn from eight times as many.
    seed : int
        Must be equal for pairings that are compared.
    """
    cars = (as_competitor(ego), as_competitor(opponent))
    meeting = game_between(game, *cars)
    check_whole("lines", lines, 1, 1000)
    # A wrong seed is refused here, in the words of the function that will use it, before anything is drawn with it.
    race_seeds(seed, 1)
    first = _variants("egos", egos, variant_count(meeting, cars[0]), seed, 3)
    second = _variants("opponents", opponents, variant_count(meeting, cars[1]), seed, 4)
    rules = replace(meeting.setup.config, start_lines=lines * LINE_SETS)
    positions = start_lines(meeting.track, rules, np.random.SeedSequence(seed, spawn_key=(0,)))
    # The side changes fastest: races 2j and 2j + 1 are the two sides of one line, as in a schedule.
    grid = np.meshgrid(first, second, np.arange(lines), np.arange(2), indexing="ij")
    a, b, own_line, side = (axis.reshape(-1).astype(np.int64) for axis in grid)
    pairs = len(first) * len(second)
    # If the lines were the same for all pairs, their effect would not average out, however many pairs there are.
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(5,)))
    rounds = [generator.permutation(lines * LINE_SETS) for _ in range(-(-pairs // LINE_SETS))]
    line = np.concatenate(rounds)[np.repeat(np.arange(pairs), 2 * lines) * lines + own_line]
    return Pairing(
        game, *cars, np.stack([a, b], axis=1), Starts(positions[line], side), race_seeds(seed, len(line)), int(seed)
    )


def _variants(noun: str, requested: int | Sequence[int], available: int, seed: int, stream: int) -> NDArray[np.int64]:
    # The streams 0, 3, 4 and 5 are the draws of one pairing: another number of egos leaves the opponents as they are.
    if is_whole(requested):
        if requested < 1:
            raise InputError(f"{noun} is {requested}; a pairing needs at least one variant")
        generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream,)))
        return np.sort(generator.permutation(available)[: int(requested)])
    indices = check_whole_array(noun, requested, (None,), minimum=0, maximum=available - 1)
    if len(indices) == 0 or len(np.unique(indices)) < len(indices):
        raise InputError(f"{noun} is {requested!r}; it must be a number of variants, or a list of different ones")
    return indices
