"""Batch of matches for the environments of a series of races."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from pcs_racing.base.settings import ANYTHING
from pcs_racing.envs.batch import BatchStep, Generators, Rows, check_within
from pcs_racing.envs.game_batch import GameBatch, GameOptions, MovesArguments
from pcs_racing.envs.infos import Result, codes, of_players
from pcs_racing.game.competitor import Chooser
from pcs_racing.game.match import KEEP, MatchGame, MatchState, ask_choices, put_matches
from pcs_racing.game.rules import OUTSIDE
from pcs_racing.race.races import start_races
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import RaceState


class MatchArguments(MovesArguments, total=False):
    """Types of the arguments of :class:`MatchOptions` and of the rules, for editors."""

    races: int
    race_moves: bool


@dataclass(frozen=True, eq=False)
class MatchOptions(GameOptions):
    """Arguments of the environments of matches."""

    opponent: Annotated[
        Any,
        ANYTHING,
        "As for :class:`pcs_racing.envs.duel.DuelEnv`; one is drawn for each match. One that makes"
        " moves starts every race of the match with the same policy of the archive, and makes its"
        " moves in the races. An object with ``choose(observation) -> policies`` chooses before"
        " each race, as the player does, and keeps its policy in the race. With None a second agent"
        " drives car 1, where the environment has one.",
    ] = "never-switch"
    races: Annotated[int, Interval(ge=1, le=100), "Races of a match."] = 3
    race_moves: Annotated[bool, "Whether the player also makes the moves of the races."] = False

    # The reward of a match is the number of races won.
    unused: ClassVar[tuple[str, ...]] = ("race", "utility", "fault_penalty", "discount")


@dataclass(frozen=True, eq=False)
class TwoPlayerMatchOptions(MatchOptions):
    """Arguments of the environments of matches with a second agent in car 1."""

    opponent: Annotated[Any, ANYTHING, "An opponent in place of the second agent."] = None


class MatchBatch(GameBatch):
    """Batch of matches; car 0 belongs to a player, car 1 to an opponent or a second player.

    A step is a whole race, unless the players also make the moves of the races. Track, cars and
    obstacles are drawn for the match and stay the same in its races.
    """

    options: MatchOptions
    played_in = "matches"

    def __init__(self, episodes: int, options: MatchOptions, **more: Any) -> None:
        super().__init__(episodes, options, **more)
        self.codes = {**self.codes, "race_result": codes(Result)}
        self.played: MatchState | None = None  #: Matches; None before `restart`.
        #: Initial states and policy parameters of the last step's driving, in a batch of one match.
        self.driven: list[tuple[RaceState, NDArray[np.float64]]] = []

    def _set_rules(self) -> None:
        options = self.options
        self.match = MatchGame(self.game, options.races, options.race_moves)
        self.elements = self.match.observation_elements
        self.actions = tuple(f"policy {i}" for i in range(len(self.game.archive)))
        self.horizon = options.races
        if options.race_moves:
            self.actions += self.game.move_names
            self.horizon *= self.game.config.moves + 1

    def restart(self, rows: Rows, generators: Generators, options: Mapping[str, Any] = {}) -> None:
        """Begin new matches in some rows, with options for each or for all.

        Each match is drawn from its own generator. :class:`pcs_racing.envs.match.MatchEnv`
        describes the options.
        """
        starts, policies, boxes = self._read(options, len(rows))
        self.randomization.draw(rows, generators)
        keys = np.array([generator.integers(2**63) for generator in generators], np.uint64)
        drawn, fixed = self._draw_opponents(generators)
        # All rows on any track, for the shapes; then each track writes its own rows.
        fresh = self.match.begin(keys, opponents=fixed)
        for circuit, some in self.randomization.groups(rows):
            own = None if starts is None else starts.take(some)
            begun = self.match_on(circuit).begin(
                keys[some],
                policies=policies[some],
                lines=None if own is None else own.s[:, None],
                sides=None if own is None else own.side,
                opponents=[fixed[i] for i in some],
            )
            put_matches(fresh, some, begun)
        self.randomization.place_obstacles(rows, fresh.starts, generators, boxes)
        self.played = self.played or self._blank()
        put_matches(self.played, rows, fresh)
        self.drawn[rows], self.moves[rows], self.blamed[rows] = drawn, -1, False
        self._forget(rows)
        self.driven = []
        self._follow(self.played)

    def match_on(self, circuit: int) -> MatchGame:
        """Return the rules on a track, by its number."""
        game = self.game_on(circuit)[0]
        return self.match if game is self.match.game else replace(self.match, game=game)

    def _follow(self, played: MatchState) -> None:
        """Continue with this state."""
        self.played, self.state = played, played.game
        self.seen = self.match.observation(played)

    def step(self, actions: NDArray[np.int64], generators: Generators) -> BatchStep:
        """Apply the players' choices and drive a race, or one step of a race with moves."""
        self.started()
        before: MatchState = self.played  # type: ignore[assignment]
        self.driven = []
        racing = np.flatnonzero(before.racing)
        played = self._start(before, actions)
        if self.match.race_moves:
            if len(racing):
                played = self._move(played, racing, generators, actions)
        else:
            # Crashes end races at different times; the other races are driven to their end.
            while (going := np.flatnonzero(played.racing)).size:
                played = self._move(played, going, generators, None)
        self._follow(played)
        # A new race begins without faults; in a match that is over none is driven.
        kept = (before.racing | self.match.done(before))[:, None]
        self.blamed = played.game.race.fault > np.where(kept, before.game.race.fault, 0)
        rewards = np.ascontiguousarray(
            self.match.reward(before, played)[:, : self.players]
        ).reshape(-1)
        done = np.repeat(self.match.done(played), self.players)
        return BatchStep(self._observations(), rewards, done, np.zeros(len(done), np.bool_))

    def _start(self, played: MatchState, actions: NDArray[np.int64]) -> MatchState:
        """Start the next races of the matches between two races."""
        between = np.flatnonzero(~played.racing & ~self.match.done(played))
        if len(between) == 0:
            return played
        choices = np.full((self.episodes, 2), KEEP, np.int64)
        choices[:, : self.players] = np.where(actions < len(self.game.archive), actions, KEEP)
        conditions = self.randomization.conditions(self._rows)
        memory, started = self.match.memory(played)[:, 1], played
        for circuit, some in self.randomization.groups(between):
            match, on = self.match_on(circuit), between[some]
            for k, opponent in enumerate(self.game_on(circuit)[1]):
                rows = on[self.drawn[on] == k]
                if len(rows) and isinstance(opponent.competitor, Chooser):
                    chosen = ask_choices(
                        opponent.competitor, match, played, 1, rows=rows, memory=memory
                    )
                    choices[rows, 1] = chosen[rows]
            started = match.start(started, choices, on, conditions)
        # A new race is a new game for an opponent with a memory.
        self._forget(between)
        self.moves[between] = -1
        # Only single environments make films; a batch does not need the copies.
        if self.episodes == 1:
            race, setup = int(played.race[0]), self.game_of(0).setup
            starts = Starts(played.starts[:, race], played.sides[:, race])
            grid = start_races(setup, starts, played.noise[:, race], conditions)
            self.driven.append((grid, started.game.theta))
        return started

    def _move(
        self, played: MatchState, rows: Rows, generators: Generators, actions: Rows | None
    ) -> MatchState:
        """Drive a step of the current races; without actions the players keep their policies."""
        game, stay = self.game, len(self.game.competitor_moves) - 1
        moves = np.full((self.episodes, 2), stay, np.int64)
        if actions is not None:
            policies = len(game.archive)
            # Actions below the number of policies are choices, without effect during a race.
            moves[:, : self.players] = np.where(actions < policies, stay, actions - policies)
        if self.players == 1:
            seen = game.observation(played.game)
            replies = self._replies(played.game, rows, generators, seen[:, 1])
            # A chooser keeps its policy during the race, even if it could also move.
            choosing = np.array([isinstance(each.competitor, Chooser) for each in self.opponents])
            moves[:, 1] = np.where(choosing[self.drawn], stay, replies)
        self.moves[rows] = moves[rows]
        conditions, moved = self.randomization.conditions(self._rows), played
        for circuit, some in self.randomization.groups(rows):
            moved = self.match_on(circuit).move(moved, moves, rows[some], conditions)
        if self.episodes == 1:
            self.driven.append((played.game.race, moved.game.theta))
        return moved

    def _pieces(self) -> list[tuple[RaceState, NDArray[np.float64]]]:
        return list(self.driven)

    # Masks and infos

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the mask of valid policies and moves, shape (environments, A)."""
        return self._masks()[:, : self.players].reshape(self.episodes * self.players, -1)

    def _masks(self) -> NDArray[np.bool_]:
        self.started()
        played: MatchState = self.played  # type: ignore[assignment]
        policies = len(self.game.archive)
        masks = np.ones((self.episodes, 2, len(self.actions)), np.bool_)
        if self.match.race_moves:
            masks[:, :, :policies] = ~played.racing[:, None, None]
            masks[:, :, policies:] = (
                self.game.action_mask(played.game) & played.racing[:, None, None]
            )
        return masks

    def infos(self) -> dict[str, NDArray[Any]]:
        """Return the infos of all players, described in :mod:`pcs_racing.envs.infos`."""
        infos, players = super().infos(), self.players
        played: MatchState = self.played  # type: ignore[assignment]
        own = played.scores.sum(axis=2)
        other = own[:, ::-1]
        result = np.where(own > other, Result.WIN, np.where(own < other, Result.LOSS, Result.TIE))
        over = self.match.done(played)[:, None]
        return {
            **infos,
            "result": of_players(np.where(over, result, Result.RUNNING).astype(np.int64), players),
            "race": np.repeat(played.race, players),
            "race_result": infos["result"],
            "score": of_players(own, players),
            "opponent_score": of_players(other, players),
            "action_mask": of_players(self._masks(), players).astype(np.int8),
        }

    # State of the batch

    def value(self) -> MatchState | None:
        """Return the state of the matches; None before the first `restart`."""
        return self.played

    def _continue(self, played: Any) -> None:
        self.driven, self.played, self.state = [], None, None
        if played is not None:
            self._follow(played)

    def _check_value(self, played: Any, lengths: NDArray[np.float64]) -> None:
        super()._check_value(played.game, lengths)
        check_within("the state's matches.race", played.race, 0, self.match.races)
        check_within("the state's matches.sides", played.sides, 0, 1)
        check_within(
            "the state's matches.policy", played.policy, OUTSIDE, len(self.game.archive) - 1
        )

    def _blank(self) -> MatchState:
        # A policy of car 1 for each match, if its planner is not the archive's planner.
        policies = self.opponents[0].policies if self.opponents else ()
        fixed = [policies[0] if policies else None] * self.episodes
        return self.match.begin(np.zeros(self.episodes, np.uint64), opponents=fixed)
