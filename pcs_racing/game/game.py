"""The game: two players watch for a step, then each moves its policy in the Policy Characteristic Space, step by step.

This is the only place that knows the rules. Environments, game trees and tournaments all play through
:class:`RaceGame`: functions from one :class:`GameState` to the next, for many games at a time. Nothing is hidden: a
game is its state, and the same seed gives the same game in a batch of any size.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.characteristics import Characteristic, Segment, get_characteristics, measure
from pcs_racing.game.config import UTILITIES, GameConfig, load_game_config
from pcs_racing.game.moves import duplicate_moves, move_names, move_table
from pcs_racing.game.state import GameState, empty_game, join_games, load_game, put_games, save_game, take_games
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.planners.registry import get_planner
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.races import RaceSetup, advance, start_lines, start_races, winners
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import RaceState
from pcs_racing.track.track import Track, load_track

__all__ = [
    "UTILITIES",
    "GameConfig",
    "GameState",
    "ObservationElement",
    "RaceGame",
    "encode_observation",
    "join_games",
    "load_game",
    "load_game_config",
    "make_game",
    "observation_elements",
    "observation_table",
    "save_game",
    "take_games",
]

Indices = NDArray[np.int64]
Floats = NDArray[np.float64]

DRAW = -1
"""In place of a policy's index: draw one."""

OUTSIDE = -1
"""In a state's ``policy``: a driver from outside the archive."""

LOW, HIGH = -1.0, 2.0  # bounds of normalised coordinates as the players see them
LEAD_SCALE = 20.0  # m of lead that players see as 1
LEAD_BOUND = 5.0
REDRAWS = 20  # times that a game which ends before the first move is drawn again


PAPER_GAME = GameConfig()


class ObservationElement(NamedTuple):
    """What one number of an observation is: spaces and documentation are made of these.

    Attributes
    ----------
    name : str
    unit : str
    low, high : float
        Bounds, inclusive.
    meaning : str
    """

    name: str
    unit: str
    low: float
    high: float
    meaning: str


def observation_elements(characteristics: Sequence[Characteristic], moves: int) -> tuple[ObservationElement, ...]:
    """What each number of an observation is, for these axes and so many moves."""
    elements = []
    for k in range(moves + 1):
        for axis in characteristics:
            meaning = f"the own policy's {axis.name} in step {k}, from the archive"
            elements.append(ObservationElement(f"own_{axis.name}_{k}", "range", LOW, HIGH, meaning))
        for axis in characteristics:
            meaning = f"the opponent's {axis.name} as measured in step {k} alone"
            elements.append(ObservationElement(f"opponent_{axis.name}_{k}", "range", LOW, HIGH, meaning))
        meaning = f"own lead at the end of step {k}"
        elements.append(ObservationElement(f"lead_{k}", f"{LEAD_SCALE:g} m", -LEAD_BOUND, LEAD_BOUND, meaning))
        meaning = f"1 once step {k} is over; until then it and the numbers above are 0"
        elements.append(ObservationElement(f"seen_{k}", "1", 0.0, 1.0, meaning))
    return (*elements, ObservationElement("step", "1", 0.0, 1.0, "share of the moves that have been made"))


def observation_table(elements: Sequence[ObservationElement], moves: int | None = None) -> str:
    """Table of an observation's elements in Markdown; with ``moves``, those of all steps ``k`` share a row."""
    rows = [(str(i), *element) for i, element in enumerate(elements)]
    if moves is not None:
        block = (len(elements) - 1) // (moves + 1)
        shared = [
            element._replace(name=element.name[:-1] + "k", meaning=element.meaning.replace("step 0", "step k"))
            for element in elements[:block]
        ]
        rows = [(f"{block}k + {i}", *element) for i, element in enumerate(shared)] + rows[-1:]
    head = ("index", "name", "unit", "low", "high", "meaning")
    cells = [head, ("---",) * len(head), *((*row[:3], f"{row[3]:g}", f"{row[4]:g}", row[5]) for row in rows)]
    return "\n".join(f"| {' | '.join(row)} |" for row in cells)


@dataclass(frozen=True, eq=False)
class RaceGame:
    """The game on one track with one archive.

    Attributes
    ----------
    track : Track
    archive : PolicyArchive
        Where both players' policies come from.
    config : GameConfig
        The rules.
    opponent_planner : Planner or str, optional
        Planner of car 1, where its drivers come from outside the archive (``reset(opponents=...)``); by default the
        archive's.
    threads : int, optional
        Threads to share the races of a batch; all cores by default. It does not change the result.
    ego_planner : Planner or str, optional
        The same for car 0 (``reset(egos=...)``).

    Raises
    ------
    InputError
        If the track has no room for the start, or the archive and its planner do not fit.
    UnknownNameError
        If the archive's planner or one of the game's characteristics is unknown.
    """

    track: Track
    archive: PolicyArchive
    config: GameConfig = PAPER_GAME
    opponent_planner: Planner | str | None = None
    threads: int | None = None
    ego_planner: Planner | str | None = None

    def __post_init__(self) -> None:
        if self.config.characteristics is not None and self.config.characteristics != self.archive.characteristics:
            object.__setattr__(self, "archive", self.archive.project(self.config.characteristics))
        family = self.archive.family()
        first, second = (
            get_planner(planner) if isinstance(planner, str) else planner or family
            for planner in (self.ego_planner, self.opponent_planner)
        )
        setup = RaceSetup(self.track, self.config.race_rules, (first, second))
        theta = np.zeros((len(self.archive), setup.theta_size))
        width = min(theta.shape[1], self.archive.parameters.shape[1])  # less if neither car can drive its policies
        theta[:, :width] = self.archive.parameters[:, :width]
        object.__setattr__(self, "_theta", theta)
        object.__setattr__(self, "_setup", setup)
        object.__setattr__(
            self,
            "_lines",
            start_lines(self.track, setup.config, np.random.SeedSequence(0, spawn_key=(0,)), split="train"),
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what the game was made of, not what was derived from it."""
        return RaceGame, (
            self.track,
            self.archive,
            self.config,
            self.opponent_planner,
            self.threads,
            self.ego_planner,
        )

    def __copy__(self) -> "RaceGame":
        """Return the game itself: it never changes."""
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> "RaceGame":
        """Return the game itself: it never changes."""
        return self

    # What the players know beforehand

    @property
    def setup(self) -> RaceSetup:
        """Track, race rules and planners, as :func:`pcs_racing.advance` wants them."""
        return self._setup  # type: ignore[attr-defined]

    @cached_property
    def characteristics(self) -> tuple[Characteristic, ...]:
        """Axes of the game."""
        return get_characteristics(self.archive.characteristics)

    @cached_property
    def table(self) -> Indices:
        """Where every move leads from every policy, shape (K, M)."""
        return move_table(self.archive, self.config.epsilon, bool(self.config.stay))

    @cached_property
    def points(self) -> Floats:
        """Normalised coordinates of the archive's policies as the players see them, shape (K, G)."""
        return np.clip(self.archive.normalised, LOW, HIGH)

    @property
    def start_lines(self) -> Floats:
        """Arc lengths of the lines that :meth:`reset` draws from, m; places of training, which no table uses."""
        lines: Floats = self._lines  # type: ignore[attr-defined]
        return lines

    @cached_property
    def move_names(self) -> tuple[str, ...]:
        """Names of the M moves, for people."""
        return move_names(self.archive, self.config.epsilon, bool(self.config.stay))

    @cached_property
    def observation_elements(self) -> tuple[ObservationElement, ...]:
        """What each of the D numbers of an observation is."""
        return observation_elements(self.characteristics, self.config.moves)

    # Playing

    def reset(
        self,
        seeds: ArrayLike | None = None,
        *,
        games: int | None = None,
        seed: int = 0,
        policies: ArrayLike | None = None,
        starts: Starts | None = None,
        opponents: Policy | Sequence[Policy | None] | None = None,
        egos: Policy | Sequence[Policy | None] | None = None,
        redraw: bool = True,
    ) -> GameState:
        """Start a batch of games and drive the step in which the players only watch.

        Everything that is drawn for a game (start line, side, policies, noise) is a function of its own key, whatever
        the size of the batch.

        Parameters
        ----------
        seeds : int or array of int, shape (B,), optional
            Key of each game. By default they are derived from ``seed`` for as many games as ``games`` says (1).
        games : int, optional
            Number of games, if there are no ``seeds``.
        seed : int
            Root of the keys, if there are no ``seeds``.
        policies : array of int, shape (B, 2) or (2,), optional
            Policies that the cars of each game start with; -1 draws one, uniformly from the archive.
        starts : Starts, optional
            Where the cars start; by default drawn out of ``config.race.start_lines`` lines and both sides.
        opponents : Policy or sequence of B (Policy or None), optional
            Drivers of car 1 from outside the archive, all of ``opponent_planner``: its moves do nothing then.
        egos : Policy or sequence of B (Policy or None), optional
            The same for car 0 and ``ego_planner``.
        redraw : bool
            Draw a game again (up to 20 times) if it ends by a crash before the first move. A game of which start and
            policies are given is never drawn again: it is over at once.

        Raises
        ------
        InputError
            If a number, shape or start is impossible; the game's index is named.
        """
        keys = self._keys(seeds, games, seed)
        count = len(keys)
        chosen = self._policies(policies, count)
        drivers = [self._outside(car, given, count) for car, given in enumerate((egos, opponents))]
        outside, theta = (np.stack(pair, axis=1) for pair in zip(*drivers, strict=True))
        if starts is not None and len(starts) != count:
            raise InputError(f"there are {count} games but {len(starts)} starts; give one start for each game")
        drawn = (chosen == DRAW) & ~outside
        chosen[outside] = OUTSIDE

        def begin(rows: Indices, attempt: int) -> GameState:
            draws = _draws(keys[rows], attempt)
            lots = (draws[:, 2:4] % np.uint64(len(self.archive))).astype(np.int64)
            picked = np.where(drawn[rows], lots, chosen[rows])
            if starts is not None:
                place = starts.take(rows)
            else:
                which = (draws[:, 0] % np.uint64(len(self.start_lines))).astype(np.int64)
                place = Starts(self.start_lines[which], (draws[:, 1] % np.uint64(2)).astype(np.int64))
            return self._watch(picked, place, draws[:, 4], theta[rows], outside[rows])

        state = begin(np.arange(count), 0)
        free = drawn.any(axis=1) | (starts is None)
        for attempt in range(1, REDRAWS + 1):
            again = np.flatnonzero(state.race.crashed & free)
            if not redraw or len(again) == 0:
                break
            put_games(state, again, begin(again, attempt))
        return state

    def step(self, state: GameState, actions: ArrayLike) -> GameState:
        """Let both players of every game move, and drive on for a step.

        Games that are over stand still. The argument stays as it is.

        Parameters
        ----------
        state : GameState
        actions : array of int, shape (B, 2)
            Index of each car's move in :attr:`move_names`; that of a driver from outside the archive does nothing.

        Raises
        ------
        InputError
            If the actions have another shape or type, or one of them is no move; the game's index is named.
        """
        moves = np.asarray(actions)
        if moves.shape != (state.games, 2) or moves.dtype.kind not in "iu":
            raise InputError(
                f"actions have shape {moves.shape} and type {moves.dtype}; they must be whole numbers of shape "
                f"({state.games}, 2)"
            )
        wrong = np.argwhere((moves < 0) | (moves >= len(self.move_names)))
        if len(wrong):
            game, car = (int(i) for i in wrong[0])
            raise InputError(
                f"game {game}, car {car}: action {moves[game, car]} is no move; it must lie in "
                f"0 to {len(self.move_names) - 1} ({', '.join(self.move_names)})"
            )
        new = state.copy()
        moving = ~self.done(state)[:, None] & (state.policy >= 0)
        # A driver from outside has policy -1: the row looked up for it is not used.
        new.policy[:] = np.where(moving, self.table[state.policy, moves.astype(np.int64)], state.policy)
        new.theta[:] = np.where(moving[..., None], self._theta[new.policy], state.theta)  # type: ignore[attr-defined]
        new.step[:] = state.step + ~self.done(state)
        self._drive(new, ~self.done(state))
        return new

    def done(self, state: GameState) -> NDArray[np.bool_]:
        """Whether each game is over, shape (B,): all moves made and driven, or a crash."""
        return (state.step >= self.config.moves) | state.race.crashed

    def utility(self, state: GameState) -> Floats:
        """What the outcome is worth to each car, shape (B, 2); 0 while a game goes on. The two always add up to 0."""
        first = np.where(self.done(state), self.worth(state.race, state.step), 0.0)
        return np.stack([first, 0.0 - first], axis=1)

    def worth(self, races: RaceState, moves: ArrayLike) -> Floats:
        """What races that ended like this are worth to car 0, shape (B,).

        Parameters
        ----------
        races : RaceState
            Of which only progress, crashes and faults count.
        moves : array of int, shape (B,) or ()
            Moves made until the end.
        """
        if self.config.utility == "win":
            winner = winners(self.setup.config, races)
            first = np.where(winner == 0, 1.0, np.where(winner == 1, -1.0, 0.0))
        else:
            first = races.lead
            if self.config.utility == "lead":
                first = np.where(races.crashed, 0.0, first)
        fault = races.fault.astype(np.float64)
        first = first + self.config.fault_penalty * (fault[:, 1] - fault[:, 0])
        made = np.asarray(moves)
        factors = np.full(made.max(initial=0) + 1, self.config.discount)
        factors[0] = 1.0
        return np.asarray(first * np.cumprod(factors)[made], np.float64)  # not "**", whose bits depend on the processor

    def winner(self, state: GameState) -> NDArray[np.int8]:
        """The car that won (0 or 1), shape (B,); -1 for a tie, a crash that pays nobody, and while a game goes on."""
        ahead = winners(self.setup.config, state.race)
        return np.where(self.done(state), ahead, -1).astype(np.int8)

    def observation(self, state: GameState) -> NDArray[np.float32]:
        """What each player sees, shape (B, 2, D); :attr:`observation_elements` says what it is."""
        return encode_observation(state.own, state.estimates, state.leads, state.step)

    def action_mask(self, state: GameState) -> NDArray[np.bool_]:
        """Moves that a player may make, shape (B, 2, M).

        All of them, unless ``mask_duplicates`` rules out those that lead where an earlier one leads.
        """
        if not self.config.mask_duplicates:
            return np.ones((state.games, 2, len(self.move_names)), np.bool_)
        allowed = ~self._duplicates[state.policy]
        allowed[state.policy < 0] = True
        return allowed

    @cached_property
    def _duplicates(self) -> NDArray[np.bool_]:
        return duplicate_moves(self.table)

    # How a game begins, and a step of driving

    def _keys(self, seeds: ArrayLike | None, games: int | None, seed: int) -> NDArray[np.uint64]:
        if seeds is None:
            count = 1 if games is None else games
            for what, value, least in (("games", count, 0), ("seed", seed, 0)):
                if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
                    raise InputError(f"{what} is {value!r}; it must be a whole number from {least}")
            return race_seeds(int(seed), int(count))
        if games is not None:
            raise InputError(f"games is {games!r}, but there are seeds, one for each game; give one of the two")
        keys = np.atleast_1d(np.asarray(seeds))
        if keys.ndim != 1 or keys.dtype.kind not in "iu" or (keys.dtype.kind == "i" and (keys < 0).any()):
            raise InputError(f"seeds are {seeds!r}; they must be whole numbers from 0, one for each game")
        return keys.astype(np.uint64)

    def _policies(self, policies: ArrayLike | None, games: int) -> Indices:
        if policies is None:
            return np.full((games, 2), DRAW, np.int64)
        chosen = np.asarray(policies)
        if chosen.shape not in ((2,), (games, 2)) or chosen.dtype.kind not in "iu":
            raise InputError(
                f"policies have shape {chosen.shape} and type {chosen.dtype}; they must be whole numbers of shape "
                f"(2,) or ({games}, 2)"
            )
        chosen = np.array(np.broadcast_to(chosen, (games, 2)), np.int64)
        wrong = np.argwhere((chosen < DRAW) | (chosen >= len(self.archive)))
        if len(wrong):
            game, car = (int(i) for i in wrong[0])
            raise InputError(
                f"game {game}, car {car}: policy {chosen[game, car]} is not in archive {self.archive.name!r}; it must "
                f"lie in 0 to {len(self.archive) - 1}, or be -1 to be drawn"
            )
        return chosen

    def _outside(
        self, car: int, given: Policy | Sequence[Policy | None] | None, games: int
    ) -> tuple[NDArray[np.bool_], Floats]:
        """Which games have a driver from outside in a car, and its parameters."""
        who = ("ego", "opponent")[car]
        drivers = [given] * games if given is None or isinstance(given, Policy) else list(given)
        if len(drivers) != games:
            raise InputError(f"there are {games} games but {len(drivers)} {who}s; give one {who} for each game")
        theta = np.zeros((games, self.setup.theta_size))
        planner = self.setup.planners[car]
        own = planner is get_planner(self.archive.planner)
        for i, driver in enumerate(drivers):
            if driver is None and not own:
                raise InputError(
                    f"game {i}: car {car} is driven by planner {planner.name!r}, which the archive holds no policy of; "
                    f"give {who}s"
                )
            if driver is not None and (not isinstance(driver, Policy) or driver.planner is not planner):
                found = f"planner {driver.planner.name!r}" if isinstance(driver, Policy) else repr(driver)
                raise InputError(
                    f"game {i}: the {who} is of {found}; this game's car {car} takes policies of planner "
                    f"{planner.name!r} (make the game with {who}_planner=...)"
                )
            if driver is not None:
                theta[i, : len(driver.parameters)] = driver.parameters
        return np.array([driver is not None for driver in drivers], np.bool_).reshape(games), theta

    def _watch(
        self, policy: Indices, starts: Starts, noise: NDArray[np.uint64], theta: Floats, outside: NDArray[np.bool_]
    ) -> GameState:
        setup = self.setup
        axes, steps = len(self.characteristics), self.config.moves + 1
        state = empty_game(len(policy), setup.memory_size, setup.theta_size, steps, axes)
        state = state._replace(race=start_races(setup, starts, noise))
        state.policy[:] = policy
        state.theta[:] = self._theta[policy]  # type: ignore[attr-defined]
        state.theta[outside] = theta[outside]
        self._drive(state, np.ones(len(policy), np.bool_))
        return state

    def _drive(self, state: GameState, going: NDArray[np.bool_]) -> None:
        """Drive a step in place, and write down for the games that go on what was to be seen."""
        rows = np.flatnonzero(going)
        now = state.step[rows]
        estimates = self._advance(state.race, state.theta)[rows]
        state.estimates[rows, :, now] = estimates
        state.own[rows, :, now] = np.where(state.policy[rows, :, None] >= 0, self.points[state.policy[rows]], estimates)
        state.leads[rows, now] = state.race.lead[rows]

    def _advance(self, races: RaceState, theta: Floats) -> Floats:
        before = races._replace(progress=races.progress.copy(), sums=races.sums.copy(), tick=races.tick.copy())
        advance(self.setup, races, theta, self.config.step_ticks, threads=self.threads)
        segment = Segment.between(before, races, self.config.step_seconds)
        return np.clip(self.archive.normalise(measure(segment, self.characteristics)), LOW, HIGH)

    def drive(self, races: RaceState, policies: Indices) -> Floats:
        """Drive a step of the game in place, with policies of the archive: what :meth:`step` does between two moves.

        For those who keep no :class:`GameState`, such as builders of game trees. Races that are over stand still.

        Parameters
        ----------
        races : RaceState
            Overwritten.
        policies : array of int, shape (B, 2)
            Index of the policy that drives each car.

        Returns
        -------
        ndarray, shape (B, 2, G)
            Normalised coordinates of each car as measured in this step: what :attr:`GameState.estimates` would hold.
        """
        return self._advance(races, self.theta(policies))

    def theta(self, policies: Indices) -> Floats:
        """Parameters of policies of the archive, as :func:`pcs_racing.advance` wants them, shape (..., P)."""
        theta: Floats = self._theta  # type: ignore[attr-defined]
        return theta[policies]


def encode_observation(own: Floats, estimates: Floats, leads: Floats, step: Indices) -> NDArray[np.float32]:
    """Put what the players saw in the order of :func:`observation_elements`.

    Parameters
    ----------
    own : ndarray, shape (B, 2, N, G)
        Normalised coordinates of each car's own policy in each of the ``N = moves + 1`` steps.
    estimates : ndarray, shape (B, 2, N, G)
        Normalised coordinates of each car as measured in each step.
    leads : ndarray, shape (B, N)
        Lead of car 0 at the end of each step, m.
    step : ndarray, shape (B,)
        Moves made so far; of later steps nothing is shown, whatever the arrays hold.

    Returns
    -------
    ndarray, shape (B, 2, D), float32
    """
    games, steps = leads.shape
    seen = np.arange(steps) <= step[:, None]
    lead = np.clip(leads / LEAD_SCALE, -LEAD_BOUND, LEAD_BOUND)
    parts = np.concatenate(
        [
            own,
            estimates[:, ::-1],
            np.stack([lead, -lead], axis=1)[..., None],
            np.broadcast_to(seen[:, None, :, None], (games, 2, steps, 1)),
        ],
        axis=-1,
    )
    parts = np.where(seen[:, None, :, None], parts, 0.0).reshape(games, 2, steps * parts.shape[-1])
    share = np.broadcast_to((step / (steps - 1))[:, None, None], (games, 2, 1))
    return np.concatenate([parts, share], axis=-1).astype(np.float32)


def make_game(
    track: Track | str | Path,
    archive: PolicyArchive | str | Path = "default",
    race: GameConfig | RaceConfig | str | Path = "paper",
    *,
    opponent_planner: Planner | str | None = None,
    threads: int | None = None,
    ego_planner: Planner | str | None = None,
    **settings: Any,
) -> RaceGame:
    """Make a game from names.

    Parameters
    ----------
    track : Track, str or path
        The circuit, its name or its folder.
    archive : PolicyArchive, str or path
        The archive, its name or its folder.
    race : GameConfig, RaceConfig, str or path
        Rules of the game; or of the race alone: a configuration, a preset's name or a YAML file.
    opponent_planner, threads, ego_planner
        See :class:`RaceGame`.
    **settings
        Fields of :class:`GameConfig` to change.

    Raises
    ------
    InputError
        If a name is unknown or a value impossible.
    """
    circuit = track if isinstance(track, Track) else load_track(track)
    rules = load_game_config(race, **settings)
    return RaceGame(circuit, load_archive(archive), rules, opponent_planner, threads, ego_planner)


def with_opponent(game: RaceGame, planner: Planner | str | None) -> RaceGame:
    """Return the game with another planner for car 1."""
    return replace(game, opponent_planner=planner)


def _draws(keys: NDArray[np.uint64], attempt: int) -> NDArray[np.uint64]:
    """Five numbers of 64 random bits for each key, shape (B, 5), by splitmix64 (Steele et al. 2014)."""
    counters = np.arange(5, dtype=np.uint64) + np.uint64(5 * attempt + 1)
    x = _mix(keys)[:, None] + counters * np.uint64(0x9E3779B97F4A7C15)
    return _mix(x)


def _mix(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))
