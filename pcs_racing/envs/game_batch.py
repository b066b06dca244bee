"""Many games side by side: the batch behind the environments of the strategy level."""

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.base.recently_used import RecentlyUsed
from pcs_racing.car.vehicle import F1TENTH
from pcs_racing.envs.batch import BatchStep, check_batch_size
from pcs_racing.envs.infos import Crash, Result, codes, of_players, race_info, race_infos, race_results
from pcs_racing.envs.obstacles import obstacles_option
from pcs_racing.envs.opponents import Opponent, draw_opponent, parse_opponents, shared_planner
from pcs_racing.envs.reset_options import start_option
from pcs_racing.envs.variety import Variety
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.competitor import ask_moves
from pcs_racing.game.config import GameConfig, load_game_config
from pcs_racing.game.moves import check_moves
from pcs_racing.game.observation import ObservationElement
from pcs_racing.game.rules import OUTSIDE, RaceGame
from pcs_racing.game.starting import check_policies
from pcs_racing.game.state import GameState, empty_game, put_games, take_games
from pcs_racing.planners.planner import Policy
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.races import advance
from pcs_racing.race.rates import DT
from pcs_racing.race.rendering import Renderer, half_sizes
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import RaceState, take
from pcs_racing.track.track import Track

NO_MOVE = -1  # before the first move, and for a driver
FILM_TICKS = 4  # simulation steps between two frames of a film
FILM_RATE = 25  # frames for each second of racing
TRAIL = 50  # frames of trail behind each car: two seconds


class DrivenStep(NamedTuple):
    """A step of one game as it can be driven again, for films."""

    #: What each piece of driving began with, as a batch of one race, and the parameters of its drivers.
    pieces: list[tuple[RaceState, NDArray[np.float64]]]
    moves: NDArray[np.int64]  #: shape (2,): Moves that began it.


@dataclass(frozen=True)
class GameOptions:
    """Arguments of the environments at the level of strategy; :class:`pcs_racing.envs.duel.DuelEnv` describes them."""

    track: Any = "Tarnfjord"
    archive: PolicyArchive | str | Path = "default"
    opponent: Any = "random-moves"
    race: GameConfig | RaceConfig | str | Path = "paper"
    deterministic_opponent: bool = True
    vehicle: Any = F1TENTH
    randomize: Any = None
    obstacles: Any = None


KEPT = 64  # games on circuits that no episode is on


class CircuitGames:
    """Games by the number of their circuit, made when they are first asked for; the last ones used are kept.

    Parameters
    ----------
    variety : Variety
        Circuits and cars of the batch.
    opponent : see :func:`pcs_racing.envs.opponents.parse_opponents`
        None where players move both cars.
    threads : int, optional
        Threads that share a step of a game.
    """

    def __init__(
        self, variety: Variety, archive: PolicyArchive, rules: GameConfig, opponent: Any, threads: int | None
    ) -> None:
        self._variety, self._archive, self._rules = variety, archive, rules
        self._opponent, self._threads = opponent, threads
        self._games: RecentlyUsed[int, tuple[RaceGame, list[Opponent]]] = RecentlyUsed(KEPT + variety.episodes)

    def on(self, circuit: int) -> tuple[RaceGame, list[Opponent]]:
        """Return the game on a circuit, by its number, and the opponents in it."""
        return self._games.get(circuit, lambda: self._make(circuit))

    def _make(self, circuit: int) -> tuple[RaceGame, list[Opponent]]:
        game = RaceGame(
            self._variety.circuits.track(circuit),
            self._archive,
            self._rules,
            threads=self._threads,
            vehicles=self._variety.cars,
            most_delay=self._variety.randomization.most_delay,
        )
        opponents = [] if self._opponent is None else parse_opponents(self._opponent, game)
        planner = shared_planner(opponents, game)
        if planner is not game.setup.planners[1]:
            game = replace(game, opponent_planner=planner)
        return game, opponents


class GameBatch:
    """Games of moves; car 0 belongs to a player, car 1 to an opponent or to a second player.

    Implements :class:`pcs_racing.envs.batch.Batch`.

    Parameters
    ----------
    episodes : int
        Number of games.
    archive, race, **settings
        As in :func:`pcs_racing.game.make.make_game`.
    track, vehicle, randomize, obstacles
        As in :class:`pcs_racing.envs.variety.Variety`.
    opponent : see :func:`pcs_racing.envs.opponents.parse_opponents`
        None where a second player moves car 1.
    deterministic_opponent : bool
        Whether trained models take their best move or draw one.
    threads : int, optional
        Threads that share a step.
    players : int
        2 where there is no opponent.
    """

    reset_options: tuple[str, ...] = ("policies", "start", "obstacles")
    frame_rate = 1
    film_rate: int | None = FILM_RATE

    def __init__(
        self,
        episodes: int,
        *,
        track: Any,
        archive: PolicyArchive | str | Path,
        opponent: Any,
        race: GameConfig | RaceConfig | str | Path,
        deterministic_opponent: bool = True,
        vehicle: Any = F1TENTH,
        randomize: Any = None,
        obstacles: Any = None,
        threads: int | None = None,
        players: int = 1,
        **settings: Any,
    ) -> None:
        check_batch_size(episodes, threads)
        if (opponent is None) is (players == 1):
            raise InputError(
                f"opponent is {opponent!r}; "
                + ("name one, for instance 'random-moves'" if players == 1 else "both cars belong to players here")
            )
        self.episodes, self.players = int(episodes), players
        self.variety = Variety(self.episodes, track, vehicle, randomize, obstacles)
        if "lidar_noise" in self.variety.drawn:
            raise ConfigError("randomize holds lidar_noise; the cars of this environment have no lidar")
        rules = load_game_config(race, **settings)
        self._games = CircuitGames(self.variety, load_archive(archive), rules, opponent, threads)
        # The game on the first circuit; the rules are the same on the others.
        self.game, self.opponents = self._games.on(0)
        weights = np.array([each.weight for each in self.opponents] or [1.0])
        self._edges = np.cumsum(weights) / weights.sum()
        self._deterministic = deterministic_opponent
        self.horizon = self.game.config.moves
        low, high = (np.array([getattr(e, end) for e in self.elements], np.float32) for end in ("low", "high"))
        self.observation_space = spaces.Box(low, high, dtype=np.float32)
        self.action_space = spaces.Discrete(len(self.game.move_names))
        moves = {NO_MOVE: "none", **dict(enumerate(self.game.competitor_moves))}
        self.codes: Mapping[str, Mapping[int, str]] = {
            "crash": codes(Crash),
            "opponent_crash": codes(Crash),
            "result": codes(Result),
            "move": moves,
            "opponent_move": moves,
            "opponent": {-1: "none", **{i: each.name for i, each in enumerate(self.opponents)}},
            **self.variety.codes,
        }
        self.state: GameState | None = None  #: None before the first `restart`.
        self.before: GameState | None = None  # what the last step began with: films are driven again from it
        #: shape (episodes, 2, D): What both players observe.
        self.seen = np.zeros((self.episodes, 2, len(low)), np.float32)
        self.drawn = np.zeros(self.episodes, np.int64)  # index of each game's opponent
        #: shape (episodes, 2): Last move of each car; -1 before the first.
        self.moves = np.full((self.episodes, 2), NO_MOVE, np.int64)
        self.memories: list[Any] = [None] * self.episodes
        self._begun: list[tuple[NDArray[np.uint64], Starts | None] | None] = [None] * self.episodes  # and not moved yet

    @property
    def elements(self) -> tuple[ObservationElement, ...]:
        """Name, unit, bounds and meaning of each number of an observation."""
        return self.game.observation_elements

    @property
    def track(self) -> Track:
        """The circuit of the first episode."""
        return self.track_of(0)

    def track_of(self, environment: int) -> Track:
        """Return the circuit that an environment is on."""
        return self.game.track if self.state is None else self.variety.track(environment // self.players)

    def game_of(self, episode: int) -> RaceGame:
        """Return the game on the circuit of an episode."""
        return self._games.on(int(self.variety.circuits.number[episode]))[0]

    def check_actions(self, actions: Any, shape: tuple[int, ...]) -> NDArray[np.int64]:
        """Return moves as (episodes, players)."""
        checked = check_moves(actions, self.game.move_names, shape, ("environment",), player="action")
        return checked.reshape(self.episodes, self.players)

    def restart(
        self,
        rows: NDArray[np.int64],
        generators: Sequence[np.random.Generator],
        options: Mapping[str, Any] = {},
    ) -> None:
        """Begin new games in some places, each drawn from its own generator.

        Options: "policies", two indices of the archive for each game or for all (-1 draws one); "start", arc length of
        the line (m) and side (0 puts car 0 on the left or in front); and "obstacles", boxes (x, y, heading, length,
        width), for each game or for all.
        """
        starts = start_option(options, len(rows))
        policies = check_policies(self.game.archive, options.get("policies"), len(rows))
        boxes = obstacles_option(options, len(rows))
        self.variety.draw(rows, generators)
        if self.variety.obstacles is not None and starts is None:  # they must be known, to keep obstacles away
            lines = [self.game_of(row).start_lines for row in rows]
            drawn_lines = [line[gen.integers(len(line))] for line, gen in zip(lines, generators, strict=True)]
            starts = Starts(np.array(drawn_lines), np.array([gen.integers(2) for gen in generators], np.int64))
        places = np.zeros((len(rows), 2)) if starts is None else np.repeat(starts.s[:, None], 2, axis=1)
        self.variety.place_obstacles(rows, places, generators, boxes)
        keys = np.array([generator.integers(2**63) for generator in generators], np.uint64)
        drivers: list[Policy | None] = []
        drawn = np.zeros(len(rows), np.int64)
        for i, generator in enumerate(generators):
            if self.opponents:
                drawn[i] = draw_opponent(self._edges, generator)
            drivers.append(self.opponents[drawn[i]].draw_policy(generator) if self.opponents else None)
        if self.state is None:
            self.state = self._empty()
        for circuit, some in self.variety.groups(rows):
            fresh = self._games.on(circuit)[0].reset(
                keys[some],
                policies=policies[some],
                starts=None if starts is None else starts.take(some),
                opponents=[drivers[i] for i in some],
                conditions=self.variety.conditions(rows[some]),
            )
            put_games(self.state, rows[some], fresh)
        self.drawn[rows], self.moves[rows] = drawn, NO_MOVE
        for i, row in enumerate(rows):
            self.memories[row] = None
            self._begun[row] = keys[i : i + 1], None if starts is None else starts.take(np.array([i]))
        self.seen = self.game.observation(self.state)

    def started(self) -> GameState:
        """Return the state."""
        if self.state is None:
            raise InputError("the episode has not begun; call reset() first")
        return self.state

    def step(self, actions: NDArray[np.int64], generators: Sequence[np.random.Generator]) -> BatchStep:
        """Let both cars of every game move, and drive a step."""
        state = self.started()
        moves = actions
        if self.players == 1:
            moves = np.stack([actions[:, 0], self._replies(state, generators, self.seen[:, 1])], axis=1)
        self.before, self.state = state, self._apply(state, moves)
        self._begun = [None] * self.episodes
        self.moves = moves
        self.seen = self.game.observation(self.state)
        rewards = np.ascontiguousarray(self.game.reward(self.state)[:, : self.players]).reshape(-1)
        done = np.repeat(self.game.done(self.state), self.players)
        return BatchStep(self._observations(), rewards, done, np.zeros(len(done), np.bool_))

    def _apply(self, state: GameState, moves: NDArray[np.int64]) -> GameState:
        groups = self.variety.groups(np.arange(self.episodes))
        if len(groups) == 1:
            circuit, rows = groups[0]
            return self._games.on(circuit)[0].apply(state, moves, self.variety.conditions(rows))
        new = state.copy()
        for circuit, rows in groups:
            conditions = self.variety.conditions(rows)
            put_games(new, rows, self._games.on(circuit)[0].apply(take_games(state, rows), moves[rows], conditions))
        return new

    def _replies(
        self,
        state: GameState,
        generators: Sequence[np.random.Generator],
        seen: NDArray[np.float32],
        among: NDArray[np.int64] | None = None,
    ) -> NDArray[np.int64]:
        """Moves of the opponents, which observe ``seen``, in all games or among some."""
        replies = np.zeros(self.episodes, np.int64)
        among = np.arange(self.episodes) if among is None else among
        for circuit, some in self.variety.groups(among):
            game, opponents = self._games.on(circuit)
            on = among[some]
            for k, opponent in enumerate(opponents):
                rows = on[self.drawn[on] == k]
                if len(rows) == 0 or opponent.policies:
                    continue
                asked = ask_moves(
                    opponent.competitor,
                    game,
                    state,
                    1,
                    rows=rows,
                    observation=seen,
                    memories=self.memories,
                    generators=generators,
                    deterministic=self._deterministic,
                )
                replies[rows] = asked[rows]
        return replies

    def observe(self, rows: NDArray[np.int64], out: NDArray[np.float32]) -> None:
        """Write the observations of some games into the rows of their players."""
        out.reshape(self.episodes, self.players, -1)[rows] = self.seen[rows, : self.players]

    def _observations(self) -> NDArray[np.float32]:
        return self.seen[:, : self.players].reshape(self.episodes * self.players, -1).copy()

    def action_masks(self) -> NDArray[np.bool_]:
        """Moves that each player may make, shape (environments, M)."""
        masks = self.game.action_mask(self.started())
        return masks[:, : self.players].reshape(self.episodes * self.players, -1)

    def infos(self) -> dict[str, NDArray[Any]]:
        """Infos of all players; :mod:`pcs_racing.envs.infos` says what the numbers mean."""
        state, players = self.started(), self.players
        # A driver makes no moves, whatever stands in the array of moves.
        moves = np.where(state.policy == OUTSIDE, NO_MOVE, self.moves)
        opponents = self.drawn if self.opponents else np.full(self.episodes, -1)
        return {
            **race_infos(state.race, players),
            "result": self._results().reshape(-1),
            "opponent": np.repeat(opponents, players),
            "move": of_players(moves, players),
            "opponent_move": of_players(moves[:, ::-1], players),
            "policy": of_players(state.policy, players),
            "action_mask": of_players(self.game.action_mask(state), players).astype(np.int8),
            **{name: np.repeat(values, players) for name, values in self.variety.infos().items()},
        }

    def info(self, environment: int) -> dict[str, Any]:
        """Info of one player: plain numbers, and the mask as an array; faster than taking it from arrays of one."""
        state, (row, car) = self.started(), divmod(environment, self.players)
        info = race_info(state.race, row, car)
        over = bool(self.game.done(state)[row])
        info["result"] = int(self._results()[row, car]) if over else int(Result.RUNNING)
        info["opponent"] = self.drawn.item(row) if self.opponents else -1
        for name, each in (("move", car), ("opponent_move", 1 - car)):
            info[name] = NO_MOVE if state.policy.item(row, each) == OUTSIDE else self.moves.item(row, each)
        info["policy"] = state.policy.item(row, car)
        info["action_mask"] = self.game.action_mask(state)[row, car].astype(np.int8)
        info.update(self.variety.info(row))
        return info

    def _results(self) -> NDArray[np.int64]:
        """How each game stands for each player, shape (B, players): :class:`pcs_racing.envs.infos.Result`."""
        state = self.started()
        ended = race_results(self.game.winner(state), state.race.crashed, self.players)
        return np.where(self.game.done(state)[:, None], ended, Result.RUNNING)

    def draw(self, renderer: Renderer, environment: int) -> NDArray[np.uint8] | None:
        """Draw a game as it stands."""
        episode = environment // self.players
        return self._draw(renderer, episode, self.started().race, episode, None, self.moves[episode])

    def last_step(self, environment: int) -> DrivenStep:
        """Return the last step of a game, the one in which the players only watch included."""
        episode = environment // self.players
        return DrivenStep(self._pieces(episode), self.moves[episode].copy())

    def film(
        self, renderer: Renderer, environment: int, ticks: int | None = None, step: DrivenStep | None = None
    ) -> Iterator[NDArray[np.uint8] | None]:
        """Drive a step of a game again, by default the last, and draw a frame every so many simulation steps (4)."""
        episode = environment // self.players
        game, conditions = self.game_of(episode), self.variety.conditions(np.array([episode]))
        step = self.last_step(environment) if step is None else step
        trail: list[NDArray[np.float64]] = []
        for begun, theta in step.pieces:
            race, left = begun.copy(), game.config.step_ticks
            while left > 0:
                drive, before = min(ticks or FILM_TICKS, left), int(race.tick[0])
                advance(game.setup, race, theta, drive, threads=1, ittc=False, conditions=conditions)
                if int(race.tick[0]) == before:
                    break  # it is over
                trail = [*trail[-TRAIL + 1 :], race.cars[0, :, :2].copy()]
                yield self._draw(renderer, episode, race, 0, np.array(trail), step.moves)
                left -= drive

    def _pieces(self, episode: int) -> list[tuple[RaceState, NDArray[np.float64]]]:
        """Where the pieces of driving of an episode's last step began, and the parameters that drove them."""
        state = self.started()
        theta, begun = state.theta[episode : episode + 1].copy(), self._begun[episode]
        if begun is not None:
            conditions = self.variety.conditions(np.array([episode]))
            noise = state.race.seed[episode : episode + 1]
            return [(self.game_of(episode).grid(begun[0], noise, begun[1], conditions), theta)]
        if self.before is None or int(self.before.race.tick[episode]) >= int(state.race.tick[episode]):
            return []  # restored from a value, or standing still
        return [(take(self.before.race, [episode]), theta)]

    def _draw(
        self,
        renderer: Renderer,
        episode: int,
        race: RaceState,
        at: int,
        trails: NDArray[np.float64] | None,
        made: NDArray[np.int64],
    ) -> NDArray[np.uint8] | None:
        """Draw a moment of an episode, after some moves: race ``at`` of some races."""
        names = ("you", self.opponents[self.drawn[episode]].name) if self.opponents else ("car_0", "car_1")
        codes = self.codes["move"]
        moves = " | ".join(f"{name}: {codes[int(made[car])]}" for car, name in enumerate(names))
        text = f"{race.tick[at] * DT:.1f} s | lead of {names[0]} {race.lead[at]:+.1f} m | {moves}"
        plans = [path[:, :2] for path in race.path[at] if path.any()]
        renderer.show(self.variety.track(episode), half_sizes(self.variety.vehicles[episode]))
        shown = plans if len(plans) == 2 else None
        return renderer.render(race.cars[at], plans=shown, trails=trails, names=names, text=text)

    def forget(self, rows: NDArray[np.int64]) -> None:
        """Let what lasts for several episodes begin anew, as the generators of some episodes do."""
        self.variety.circuits.forget(rows)

    def get_state(self) -> tuple[Any, ...]:
        """Copies of all that changes: games, opponents, last moves, what the opponents remember, and what was drawn."""
        state = None if self.state is None else self.state.copy()
        return state, self.drawn.copy(), self.moves.copy(), copy.deepcopy(self.memories), self.variety.get_state()

    def set_state(self, values: tuple[Any, ...]) -> None:
        """Continue from what `get_state` returned, here or in an equal batch."""
        state, drawn, moves, memories, variety = values
        if state is not None:
            self._check_state(state)
        self.variety.set_state(variety)
        self.before, self.state = None, None if state is None else state.copy()
        self._begun = [None] * self.episodes
        self.drawn, self.moves, self.memories = drawn.copy(), moves.copy(), copy.deepcopy(memories)
        if self.state is not None:
            self.seen = self.game.observation(self.state)

    def _check_state(self, state: Any) -> None:
        if not isinstance(state, GameState) or state.games != self.episodes:
            raise InputError(f"the state is not one of {self.episodes} games; use what get_state returned")
        model = self._empty()
        names = (*model.race._fields, *model._fields[1:])
        given: list[Any] = [*state.race, *state[1:]]
        wanted: list[Any] = [*model.race, *model[1:]]
        for name, array, like in zip(names, given, wanted, strict=True):
            if np.shape(array) != like.shape:
                raise InputError(
                    f"the state's {name} has shape {np.shape(array)}; in this environment it must be {like.shape}: it "
                    "belongs to another archive, planner or number of moves"
                )
        if not ((state.policy >= OUTSIDE) & (state.policy < len(self.game.archive))).all():
            raise InputError(
                f"the state's policies {state.policy[0].tolist()} are not all in archive {self.game.archive.name!r}"
            )

    def _empty(self) -> GameState:
        setup, axes = self.game.setup, len(self.game.characteristics)
        return empty_game(self.episodes, setup.memory_size, setup.theta_size, self.game.config.moves + 1, axes)

    def close(self) -> None:
        """Stop building circuits."""
        self.variety.circuits.close()
