"""Batch of games for the strategy-level environments."""

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.settings import ANYTHING
from pcs_racing.base.typing import ObservationElement
from pcs_racing.car.vehicle import half_sizes
from pcs_racing.envs.batch import (
    FREE,
    BatchStep,
    Generators,
    Rows,
    check_batch_size,
    check_part,
    check_weights,
    check_within,
    draw_opponent,
    obstacles_option,
    start_option,
    weights_of,
)
from pcs_racing.envs.infos import (
    Result,
    common_codes,
    of_players,
    race_infos,
    race_results,
    rows_of,
)
from pcs_racing.envs.opponents import (
    Opponent,
    check_games,
    read_opponents,
    replies,
    shared_planner,
)
from pcs_racing.envs.origins import mark
from pcs_racing.envs.randomization import (
    EpisodeOptions,
    EpisodeRandomization,
)
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.moves import check_moves
from pcs_racing.game.rules import OUTSIDE, RaceGame
from pcs_racing.game.starting import check_policies
from pcs_racing.game.state import GameState, put_games, take_games
from pcs_racing.planners.planner import Policy
from pcs_racing.race.config import DT, PAPER, Rules, load_rules
from pcs_racing.race.driving import advance
from pcs_racing.race.rendering import Renderer
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import RaceState, empty_state, take
from pcs_racing.track.track import Track

NO_MOVE = -1  # code before the first move, and for a fixed policy
TRAIL = 50  # frames of trail behind each car: two seconds of a film


class DrivenStep(NamedTuple):
    """Data of a step of one game to drive it again, for films."""

    begun: RaceState | None  #: Initial state, a batch of one race; None if nothing was driven.
    theta: NDArray[np.float64]  #: shape (1, 2, P): Parameters of the policies.
    moves: NDArray[np.int64]  #: shape (2,): Moves at the start of the step.


GAME_RULES = (
    "steps",
    "epsilon",
    "stay",
    "utility",
    "fault_penalty",
    "discount",
    "characteristics",
    "mask_duplicates",
)
"""Fields of the rules that are arguments of the environments, too."""


@dataclass(frozen=True, eq=False)
class GameOptions(EpisodeOptions):
    """Arguments of the strategy-level environments."""

    archive: Annotated[
        PolicyArchive | str | Path,
        ANYTHING,
        "The policies: an archive, its name or folder.",
    ] = "default"
    opponent: Annotated[
        Any,
        ANYTHING,
        'By name: "random-moves"; "never-switch" (a policy of the archive, drawn for each episode'
        ' and kept); "always-<move>", for instance "always-aggressiveness +"; a planner such as'
        ' "lane-switcher:3", which makes no moves; or any agent of :mod:`pcs_racing_agents`, such'
        ' as "cfr-argmax". As an object: any agent with ``act(observations, turn)``; a policy; a'
        " model of Stable-Baselines3 or any object with its ``predict(observation, state,"
        " episode_start, deterministic)``; or a function ``f(observation, generator) -> move``. Of"
        " a list of opponents or (weight, opponent) pairs, one is drawn for each episode. The"
        " opponent receives the observation of car 1, and may also stay, with all rules. None for"
        " a second agent in car 1, where the environment has one.",
    ] = "random-moves"
    rules: Annotated[
        Rules | str | Path,
        ANYTHING,
        'Rules: "paper", "contest", a YAML file or a configuration.',
    ] = "paper"
    deterministic_opponent: Annotated[
        bool,
        "Whether models take their best move; else they draw with an unseeded generator.",
    ] = True

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """Return the defaults of own fields, and of fields of the rules."""
        return super().defaults() | {name: getattr(PAPER, name) for name in GAME_RULES}

    @classmethod
    def read(cls, arguments: Mapping[str, Any]) -> Self:
        """Return the configuration with these arguments; fields of the rules change ``rules``."""
        own = {one.name for one in fields(cls)}
        options = cls(**{name: value for name, value in arguments.items() if name in own})
        rules = {name: value for name, value in arguments.items() if name not in own}
        return replace(options, rules=load_rules(options.rules, **rules))


@dataclass(frozen=True, eq=False)
class TwoPlayerOptions(GameOptions):
    """Arguments of the environments with a second agent in car 1."""

    opponent: Annotated[Any, ANYTHING, "An opponent in place of the second agent."] = None


KEPT = 64  # number of cached games on tracks without an episode


class GameBatch:
    """Batch of games of moves; car 1 belongs to an opponent or to a second player."""

    reset_options: tuple[str, ...] = ("policies", "start", "obstacles")
    frame_rate = 1  #: Rate of single frames: a step is longer than a second.
    cars = 2

    def __init__(
        self,
        episodes: int,
        options: GameOptions,
        *,
        threads: int | None = None,
        players: int = 1,
    ) -> None:
        check_batch_size(episodes, threads)
        self.options, self._threads = options, threads
        if (options.opponent is None) is (players == 1):
            raise InputError(
                f"opponent is {options.opponent!r}; "
                + (
                    "name one, for instance 'random-moves'"
                    if players == 1
                    else "both cars belong to players here"
                )
            )
        self.episodes, self.players = int(episodes), players
        self.randomization = EpisodeRandomization(self.episodes, options)
        self._archive = load_archive(options.archive)
        self._rules = load_rules(options.rules)
        #: Game and opponents on a track, by the track's number.
        self.game_on = lru_cache(maxsize=KEPT + self.episodes)(self._make_game)
        # The game on the first track; the rules are the same on the other tracks.
        self.game, self.opponents = self.game_on(0)
        self.weights = weights_of(self.opponents)  #: Weights of the opponents in the draw.
        moves = {NO_MOVE: "none", **dict(enumerate(self.game.moves))}
        self.codes: Mapping[str, Mapping[int, str]] = {
            **common_codes(each.name for each in self.opponents),
            "move": moves,
            "opponent_move": moves,
            **self.randomization.codes,
        }
        self.elements: tuple[ObservationElement, ...] = self.game.observation_elements
        self.horizon = self.game.rules.moves  #: Steps of an episode.
        low, high = (
            np.array([getattr(e, end) for e in self.elements], np.float32)
            for end in ("low", "high")
        )
        origin = {"game": self.game.identity._asdict()}
        self.observation_space = mark(spaces.Box(low, high, dtype=np.float32), "duel", origin)
        self.action_space = mark(spaces.Discrete(self.game.offered), "duel", origin)
        self.state: GameState | None = None  #: State of the games; None before the first `restart`.
        self.before: GameState | None = None  # state before the last step, to drive films again
        #: shape (episodes, 2, D): Observations of both players.
        self.seen = np.zeros((self.episodes, 2, len(low)), np.float32)
        self.drawn = np.zeros(self.episodes, np.int64)  # index of each game's opponent
        #: shape (episodes, 2): Last move of each car; -1 before the first move.
        self.moves = np.full((self.episodes, 2), NO_MOVE, np.int64)
        #: shape (episodes, 2): True for a car at fault in the last step.
        self.blamed = np.zeros((self.episodes, 2), np.bool_)
        self.memories: list[Any] = [None] * self.episodes
        self._rows = np.arange(self.episodes)
        # Key and start of the first game, for films; None after its first move.
        self._begun: tuple[NDArray[np.uint64], Starts | None] | None = None

    @property
    def track(self) -> Track:
        """Track of the first episode."""
        return self.randomization.track(0)

    def _make_game(self, circuit: int) -> tuple[RaceGame, list[Opponent]]:
        opponent = self.options.opponent
        game = RaceGame(
            self.randomization.circuits.track(circuit),
            self._archive,
            self._rules,
            threads=self._threads,
            vehicles=self.randomization.cars,
            max_delays=self.randomization.ranges.max_delays,
        )
        self.randomization.check_bodies(game.setup, game.start_lines)
        opponents = [] if opponent is None else read_opponents(opponent, game)
        # Parsing the opponents needs a game, and then determines the game's planner.
        planner = shared_planner(opponents, game)
        if planner is not game.setup.planners[1]:
            game = replace(game, opponent_planner=planner)
        return game, opponents

    def game_of(self, episode: int) -> RaceGame:
        """Return the game on the track of an episode."""
        return self.game_on(int(self.randomization.circuits.number[episode]))[0]

    def check_actions(self, actions: Any, shape: tuple[int, ...]) -> NDArray[np.int64]:
        """Return actions in the shape (episodes, players)."""
        moves = self.game.moves[: self.game.offered]
        checked = check_moves(actions, moves, shape, ("environment",), player="action")
        return checked.reshape(self.episodes, self.players)

    def restart(self, rows: Rows, generators: Generators, options: Mapping[str, Any] = {}) -> None:
        """Begin new games in some rows, with options for each or for all.

        Each game is drawn from its own generator. :class:`pcs_racing.envs.duel.DuelEnv` describes
        the options.
        """
        starts = start_option(options, len(rows))
        policies = check_policies(self.game.archive, options.get("policies"), len(rows))
        boxes = obstacles_option(options, len(rows))
        self.randomization.draw(rows, generators)
        if self.randomization.obstacles is not None and starts is None:  # for the obstacles
            lines = [self.game_of(row).start_lines for row in rows]
            drawn_lines = [
                line[gen.integers(len(line))] for line, gen in zip(lines, generators, strict=True)
            ]
            starts = Starts(
                np.array(drawn_lines), np.array([gen.integers(2) for gen in generators], np.int64)
            )
        # Without drawn obstacles the places are not used.
        places = (
            np.zeros((len(rows), 2)) if starts is None else np.repeat(starts.s[:, None], 2, axis=1)
        )
        self.randomization.place_obstacles(rows, places, generators, boxes)
        # A game is a function of this key and does not depend on later draws of the generator.
        keys = np.array([generator.integers(2**63) for generator in generators], np.uint64)
        drawn, fixed = self._draw_opponents(generators)
        if self.state is None:
            self.state = self._blank()
        for circuit, some in self.randomization.groups(rows):
            fresh = self.game_on(circuit)[0].reset(
                keys[some],
                policies=policies[some],
                starts=None if starts is None else starts.take(some),
                opponents=[fixed[i] for i in some],
                conditions=self.randomization.conditions(rows[some]),
            )
            put_games(self.state, rows[some], fresh)
        self.drawn[rows], self.moves[rows], self.blamed[rows] = drawn, NO_MOVE, False
        for row in rows:
            self.memories[row] = None
        filmed = np.flatnonzero(rows == 0)
        if len(filmed):
            self._begun = keys[filmed], None if starts is None else starts.take(filmed)
        self.seen = self.game.observation(self.state)

    def _draw_opponents(
        self, generators: Generators
    ) -> tuple[NDArray[np.int64], list[Policy | None]]:
        """Draw the opponent of each new episode: its index, and its policy if it makes no moves."""
        drawn = np.zeros(len(generators), np.int64)
        if not self.opponents:
            return drawn, [None] * len(generators)
        fixed = []
        for i, generator in enumerate(generators):
            drawn[i] = draw_opponent(self.weights, generator)
            fixed.append(self.opponents[drawn[i]].draw_policy(generator))
        return drawn, fixed

    def started(self) -> GameState:
        """Return the state; raise an error before the first reset."""
        if self.state is None:
            raise InputError("the episode has not begun; call reset() first")
        return self.state

    def step(self, actions: NDArray[np.int64], generators: Generators) -> BatchStep:
        """Move both cars of every game, and drive a step."""
        state = self.started()
        moves = actions
        if self.players == 1:
            moves = np.stack(
                [actions[:, 0], self._replies(state, self._rows, self.seen[:, 1])],
                axis=1,
            )
        self.before, self.state = state, self._apply(state, moves)
        self.blamed = self.state.race.fault > state.race.fault
        self._begun = None
        self.moves = moves
        self.seen = self.game.observation(self.state)
        rewards = np.ascontiguousarray(self.game.reward(self.state)[:, : self.players]).reshape(-1)
        done = np.repeat(self.game.done(self.state), self.players)
        return BatchStep(self._observations(), rewards, done, np.zeros(len(done), np.bool_))

    def _apply(self, state: GameState, moves: NDArray[np.int64]) -> GameState:
        # On a single track the whole batch is one call, without copying games.
        groups = self.randomization.groups(self._rows)
        if len(groups) == 1:
            circuit, rows = groups[0]
            conditions = self.randomization.conditions(rows)
            return self.game_on(circuit)[0].step(state, moves, conditions, checked=True)
        new = state.copy()
        for circuit, rows in groups:
            conditions = self.randomization.conditions(rows)
            game, own = self.game_on(circuit)[0], take_games(state, rows)
            put_games(new, rows, game.step(own, moves[rows], conditions, checked=True))
        return new

    def _replies(
        self, state: GameState, rows: Rows, seen: NDArray[np.float32]
    ) -> NDArray[np.int64]:
        """Return the moves of the opponents in the games ``rows``, 0 in all others, shape (B,).

        ``seen`` are the observations of the opponents.
        """
        asked = {
            "observation": seen,
            "memories": self.memories,
            "deterministic": self.options.deterministic_opponent,
        }
        moves = np.zeros(self.episodes, np.int64)
        for circuit, some in self.randomization.groups(rows):
            game, opponents = self.game_on(circuit)
            moves += replies(opponents, self.drawn, game, state, rows[some], **asked)
        return moves

    def observe(self, rows: NDArray[np.int64], out: NDArray[np.float32]) -> None:
        """Write the observations of some games to the rows of their players."""
        out.reshape(self.episodes, self.players, -1)[rows] = self.seen[rows, : self.players]

    def both_views(self) -> NDArray[np.float32]:
        """Return the observation of each car of every game, shape (B, 2, D)."""
        return self.seen

    def _observations(self) -> NDArray[np.float32]:
        return self.seen[:, : self.players].reshape(self.episodes * self.players, -1).copy()

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the mask of valid moves of each player, shape (environments, M)."""
        masks = self.game.action_mask(self.started())
        return masks[:, : self.players].reshape(self.episodes * self.players, -1)

    def infos(self) -> dict[str, NDArray[Any]]:
        """Return the infos of all players, described in :mod:`pcs_racing.envs.infos`."""
        state, players = self.started(), self.players
        # A fixed policy makes no moves; its entry in the array of moves has no meaning.
        moves = np.where(state.policy == OUTSIDE, NO_MOVE, self.moves)
        opponents = self.drawn if self.opponents else np.full(self.episodes, -1)
        return {
            **race_infos(state.race, players, self.blamed, self.game.rules.gives_handicaps),
            "result": self._results().reshape(-1),
            "opponent": np.repeat(opponents, players),
            "move": of_players(moves, players),
            "opponent_move": of_players(moves[:, ::-1], players),
            "policy": of_players(state.policy, players),
            "action_mask": of_players(self.game.action_mask(state), players).astype(np.int8),
            **self.randomization.infos(players),
        }

    def info(self, environment: int) -> dict[str, Any]:
        """Return the info of one player: plain numbers, and the mask as an array."""
        return rows_of(self.infos(), [environment])[0].copy()

    def _results(self) -> NDArray[np.int64]:
        """Return the :class:`pcs_racing.envs.infos.Result` of each game, shape (B, players)."""
        state = self.started()
        ended = race_results(self.game.winner(state), state.race.crashed, self.players)
        return np.where(self.game.done(state)[:, None], ended, Result.RUNNING)

    def draw(self, renderer: Renderer, environment: int) -> NDArray[np.uint8] | None:
        """Draw the current state of a game."""
        episode = environment // self.players
        return self._draw(renderer, episode, self.started().race, self.moves[episode])

    def last_step(self) -> DrivenStep:
        """Return the last step of the first game; this may be the step without moves."""
        return DrivenStep(
            self._begin_of_step(), self.started().theta[:1].copy(), self.moves[0].copy()
        )

    def film(
        self, renderer: Renderer, step: DrivenStep, ticks: int
    ) -> Iterator[NDArray[np.uint8] | None]:
        """Drive a step of the first game again, and yield a frame every ``ticks`` ticks."""
        if step.begun is None:
            return
        game, conditions = self.game_of(0), self.randomization.conditions(self._rows[:1])
        race, ends = step.begun.copy(), game.rules.end_ticks
        trail: list[NDArray[np.float64]] = []
        left = int(ends[np.searchsorted(ends, race.tick[0], side="right")] - race.tick[0])
        while left > 0:
            drive, before = min(ticks, left), int(race.tick[0])
            advance(
                game.setup, race, step.theta, drive, threads=1, ittc=False, conditions=conditions
            )
            if int(race.tick[0]) == before:
                break  # end of the race
            trail = [*trail[-TRAIL + 1 :], race.cars[0, :, :2].copy()]
            yield self._draw(renderer, 0, race, step.moves, np.array(trail))
            left -= drive

    def _begin_of_step(self) -> RaceState | None:
        """Return the initial state of the last step of the first game, if it was driven."""
        state = self.started()
        # The first step was driven at the reset, from the grid; the key reproduces the grid.
        if self._begun is not None:
            if self.game.rules.end_ticks[0] == 0:
                return None  # no step driven yet
            key, start = self._begun
            conditions = self.randomization.conditions(self._rows[:1])
            return self.game_of(0).grid(key, state.race.seed[:1], start, conditions)
        if self.before is None or int(self.before.race.tick[0]) >= int(state.race.tick[0]):
            return None  # restored state, or no driving
        return take(self.before.race, [0])

    def _draw(
        self,
        renderer: Renderer,
        episode: int,
        races: RaceState,
        made: NDArray[np.int64],
        trails: NDArray[np.float64] | None = None,
    ) -> NDArray[np.uint8] | None:
        """Draw an episode of a batch of races, with the moves made."""
        names = (
            ("you", self.opponents[self.drawn[episode]].name)
            if self.opponents
            else ("car_0", "car_1")
        )
        codes = self.codes["move"]
        moves = " | ".join(f"{name}: {codes[int(made[car])]}" for car, name in enumerate(names))
        text = (
            f"{races.tick[episode] * DT:.1f} s | lead of {names[0]} {races.lead[episode]:+.1f} m |"
            f" {moves}"
        )
        plans = [path[:, :2] for path in races.path[episode] if path.any()]
        renderer.show(
            self.randomization.track(episode), half_sizes(self.randomization.vehicles[episode])
        )
        shown = plans if len(plans) == 2 else None
        return renderer.render(
            races.cars[episode],
            plans=shown,
            trails=trails,
            names=names,
            text=text,
            time=races.tick[episode] * DT,
        )

    def value(self) -> GameState | None:
        """Return the state of the games; None before the first `restart`."""
        return self.state

    def get_state(self) -> tuple[Any, ...]:
        """Return copies of all variables: games, opponents, last moves, memories, random draws,
        weights of the opponents, faults of the last step.
        """
        return (
            None if self.state is None else self.state.copy(),
            self.drawn.copy(),
            self.moves.copy(),
            copy.deepcopy(self.memories),
            self.randomization.get_state(),
            self.weights.copy(),
            self.blamed.copy(),
        )

    def check_state(self, values: tuple[Any, ...]) -> list[Track]:
        """Refuse a state that `get_state` can't have returned.

        Return the track of each episode, with its obstacles.
        """
        memories = [FREE] * self.episodes
        mine = FREE, self.drawn, self.moves, memories, FREE, self.weights, self.blamed
        check_part("the state", values, mine)
        check_weights(values[5], self.weights)
        tracks = self.randomization.check_state(values[4])
        if values[0] is not None:
            check_part(
                f"the state of {self.episodes} games",
                values[0],
                self.state or self._blank(),
            )
            lengths = np.array([track.length for track in tracks])
            check_games("the state's games", values[0], self.game, lengths)
        check_within("the state's opponents", values[1], 0, max(1, len(self.opponents)) - 1)
        check_within("the state's moves", values[2], NO_MOVE, len(self.game.moves) - 1)
        return tracks

    def set_state(self, values: tuple[Any, ...]) -> None:
        """Continue from a state of `get_state`, from this or an equal batch."""
        tracks = self.check_state(values)
        value, drawn, moves, memories, randomization, weights, blamed = values
        self.randomization.set_state(randomization, tracks)
        self.drawn, self.moves, self.memories = drawn.copy(), moves.copy(), copy.deepcopy(memories)
        self.weights, self.blamed = weights.copy(), blamed.copy()
        self.before, self._begun = None, None
        self.state = None if value is None else value.copy()
        if self.state is not None:
            self.seen = self.game.observation(self.state)

    def _blank(self) -> GameState:
        """Return an empty state of the games."""
        return self.game.empty_state(
            empty_state(self.episodes, self.game.setup.memory_size, laps=self.game.setup.rules.laps)
        )

    def close(self) -> None:
        """Stop building tracks."""
        self.randomization.circuits.close()
