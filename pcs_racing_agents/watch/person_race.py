"""A race of a person (moves or steering) in car 0 against an agent or policy in car 1."""

import re
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.seeds import race_seed
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.game.competitor import competitor_name
from pcs_racing.game.rules import RaceGame
from pcs_racing.race.races import starts_of
from pcs_racing.race.replay import Replay, replay_page, safe_json
from pcs_racing_agents.agents.agent import Competitor, Driver
from pcs_racing_agents.agents.observing import earlier, moves_made, opponent
from pcs_racing_agents.tournament import Pairing, RaceTable, repeat_race
from pcs_racing_agents.watch.explain import ExplainedDecision, explain_race, mark_moves
from pcs_racing_agents.watch.pages import rendered
from pcs_racing_agents.watch.view_server import Answer, error_answer

NEAREST = 4  # the person starts with a policy of the quarter nearest to the opponent's policy

_ADDRESS = re.compile(r"/race/([0-9]{1,6})/((?:[0-9]{1,3}(?:-[0-9]{1,3})*)?)(\.html)?")


@dataclass(frozen=True)
class _GivenMoves:
    """A competitor with given moves, then "stay"."""

    moves: tuple[int, ...]
    stay: int
    axes: int
    name: str = "you"

    def act(self, observations: NDArray[np.float32], turn: Any = None) -> NDArray[np.int64]:
        """Return the move for each observation."""
        # Stateless (from the observation): the same object serves any race, in any order.
        made = moves_made(observations, self.axes)
        padded = np.array([*self.moves, self.stay])
        return padded[np.minimum(made, len(self.moves))]


@dataclass(frozen=True, eq=False)
class PersonRaces:
    """Races of a person in car 0 against a competitor; start and policies depend on the race."""

    game: RaceGame
    opponent: Competitor  #: Competitor in car 1.
    seed: int = 0  #: Root of the starts, of both cars' start policies, and of the noise.

    def answer(self, path: str) -> Answer:
        """Answer ``/race/K/MOVES`` (:meth:`situation`, JSON) and ``/race/K/MOVES.html`` (the race).

        ``MOVES`` are the indices of the person's moves, separated by hyphens; empty before the
        first move.
        """
        match = _ADDRESS.fullmatch(path)
        if match is None:
            return error_answer(404, "there is / and /race/NUMBER/MOVES here")
        number = int(match.group(1))
        moves = tuple(int(move) for move in match.group(2).split("-") if move)
        try:
            if match.group(3):
                page = replay_page(self.replay(number, moves))
                return Answer(200, page.encode(), "text/html; charset=utf-8")
            return Answer(200, safe_json(self.situation(number, moves)).encode())
        except InputError as error:
            return error_answer(409, str(error))

    def replay(self, number: int, moves: tuple[int, ...]) -> Replay:
        """Return the race up to the person's next move, or to the end."""
        return self._drive(number, moves)[0]

    def situation(self, number: int, moves: tuple[int, ...]) -> dict[str, Any]:
        """Return the person's information before the next move, as plain values."""
        replay, played, steps = self._drive(number, moves)
        game, archive = self.game, self.game.archive
        made, over = len(moves), self._over(played, len(moves))
        # Steps after a crash have no policy (-1): use the last driven policy.
        policy = int([policy for policy in played.path[0, 0, : made + 1] if policy >= 0][-1])
        axes = get_characteristics(archive.characteristics)
        seen = [
            opponent(earlier(played.observations[:, car], len(axes), made), len(axes))[0]
            .astype(float)
            .tolist()
            for car in range(2)
        ]
        return {
            "number": number,
            "made": made,
            "moves": game.config.moves,
            "ends": game.config.ends,
            "seconds": replay.duration,
            "over": over,
            "outcome": replay.outcome,
            "winner": int(played.winner[0]) if over else None,
            "lead": float(replay.lead[-1]),
            "opponent": replay.car_names[1],
            "track": replay.track_name,
            "axes": [
                {"name": axis.name, "unit": axis.unit, "meaning": axis.meaning} for axis in axes
            ],
            "policies": archive.normalised.tolist(),
            "coordinates": archive.coordinates.tolist(),
            "policy": policy,
            "choices": [
                {
                    "name": name,
                    "policy": int(game.next_policy(np.array([policy]), np.array([move]))[0]),
                }
                for move, name in enumerate(game.competitor_moves)
            ],
            "opponent_seen": seen[0],
            "you_seen": seen[1],
            "history": [
                {
                    "you": game.competitor_moves[own],
                    "opponent": game.competitor_moves[step.move],
                    "probabilities": _listed(step.probabilities),
                    "values": _listed(step.values),
                }
                for own, step in zip(moves, steps, strict=False)
            ],
        }

    def _over(self, played: RaceTable, made: int) -> bool:
        """Return whether the race ended within the step after a number of moves."""
        return (
            made >= self.game.config.moves
            or float(played.duration[0]) < self.game.config.ends[made]
        )

    def _policies(self, number: int) -> NDArray[np.int64]:
        """Draw both cars' start policies, similar if both are from the archive (close races)."""
        archive = self.game.archive
        draw = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(1, number)))
        if isinstance(self.opponent, Driver):
            counts = [len(archive), len(self.opponent.policies)]
            return np.array([draw.integers(count) for count in counts])
        rival = draw.integers(len(archive))
        apart = np.linalg.norm(archive.normalised - archive.normalised[rival], axis=1)
        own = np.argsort(apart, kind="stable")[draw.integers(max(1, len(archive) // NEAREST))]
        return np.array([own, rival])

    def _drive(
        self, number: int, moves: tuple[int, ...]
    ) -> tuple[Replay, RaceTable, tuple[ExplainedDecision, ...]]:
        """Drive the whole race ("stay" after the given moves); return it up to the next move."""
        game, names = self.game, self.game.competitor_moves
        if len(moves) > game.config.moves:
            raise InputError(f"{len(moves)} moves were made; a race has {game.config.moves}")
        for move in moves:
            if not 0 <= move < len(names):
                raise InputError(
                    f"move {move} is none of the moves 0 to {len(names) - 1} ({', '.join(names)})"
                )
        # The whole race each time: requests share no state.
        person = _GivenMoves(moves, len(names) - 1, len(game.archive.characteristics))
        pairing = Pairing(
            game,
            person,
            self.opponent,
            self._policies(number)[None],
            starts_of(game.track, game.setup.config, [number], self.seed),
            np.array([race_seed(self.seed, number)], np.uint64),
        )
        if isinstance(self.opponent, Driver):
            recording = repeat_race(pairing, 0, candidates=False)
            whole, played = recording.replay, recording.played
            replay = mark_moves(whole, played, recording.game.competitor_moves, game.config.ends)
            steps: tuple[ExplainedDecision, ...] = ()
        else:
            explanation = explain_race(pairing, 0, car=1)
            replay, played, steps = explanation.replay, explanation.played, explanation.steps
        # Hide the future of the race, which assumes "stay" from now on.
        if not self._over(played, len(moves)):
            replay = first_frames(replay, game.config.ends[len(moves)])
        return replay, played, steps[: len(moves)]


def _listed(values: NDArray[np.float64] | None) -> list[float] | None:
    return None if values is None else values.tolist()


def first_frames(replay: Replay, seconds: float) -> Replay:
    """Return the beginning of a race: frames, plans and events up to a time, without an outcome.

    ``replay``: a replay without candidates. ``seconds``: end of the beginning, s.
    """
    frames = round(seconds / replay.frame_dt) + 1
    plans = round(seconds / replay.plan_dt)  # the next move decides the plan of that time
    return replace(
        replay,
        cars=replay.cars[:frames],
        progress=replay.progress[:frames],
        ittc=None if replay.ittc is None else replay.ittc[:frames],
        paths=None if replay.paths is None else replay.paths[:plans],
        events=tuple(event for event in replay.events if event.time < seconds),
        outcome="",
    )


def play_page(races: PersonRaces) -> str:
    """Return the page for the moves of a person; a server provides everything else."""
    title = f"You against {competitor_name(races.opponent)}"
    allowed = "connect-src 'self'; frame-src 'self'"
    return rendered("pcs_racing_agents.watch", "play.html", title=title, allowed=allowed)


TIME_STEP = 0.02  # s
MAX_STEPS = 25  # max steps per answer: half a second; a paused page continues from there

_BEGIN = re.compile(r"/begin/([0-9]{1,6})")
_DRIVE = re.compile(r"/drive/([0-9]{1,6})/([0-9]{1,6})/([0-9]{1,2})/(-?[0-9]{1,3})/([0-9]{1,3})")


@dataclass(eq=False)
class PersonDrive:
    """Races driven from a page; the start depends on the race. Equal commands give equal races."""

    env: DriveEnv  #: Environment with steps of :data:`TIME_STEP` and actions in [-1, 1].
    opponent: str  #: Name of the opponent.
    seed: int = 0  #: Seed of race 0; race ``k`` has seed + ``k``.
    _race: tuple[int, int] = field(init=False, default=(-1, 0))  # race number, steps driven
    _info: dict[str, Any] = field(init=False, default_factory=dict)

    def answer(self, path: str) -> Answer:
        """Answer ``/begin/K`` and ``/drive/K/STEP/STEPS/STEERING/SPEED`` with the race as JSON.

        ``STEP`` is the first of ``STEPS`` driven steps. The steering from -100 (right) to 100
        (left) and the speed from 0 to 100 are percentages of the maximum.
        """
        begin, on = _BEGIN.fullmatch(path), _DRIVE.fullmatch(path)
        try:
            if begin:
                return Answer(200, safe_json(self._begin(int(begin.group(1)))).encode())
            if on:
                return Answer(200, safe_json(self._drive(*map(int, on.groups()))).encode())
        except InputError as error:
            return error_answer(409, str(error))
        return error_answer(
            404, "there is /, /begin/NUMBER and /drive/NUMBER/STEP/STEPS/STEERING/SPEED here"
        )

    def _begin(self, number: int) -> dict[str, Any]:
        self._info = self.env.reset(seed=self.seed + number)[1]
        self._race = number, 0
        track = self.env.batch.track
        walls, line = (
            np.round(part, 3).tolist() for part in (track.arrays.walls, track.line[:, :2])
        )
        return {
            **self._moment(),
            "walls": walls,
            "line": line,
            "track": track.name,
            "opponent": self.opponent,
        }

    def _drive(
        self, number: int, step: int, steps: int, steering: int, speed: int
    ) -> dict[str, Any]:
        if (number, step) != self._race:
            raise InputError(
                f"race {number} is not at step {step}: another page drives here; begin a race again"
            )
        if not (1 <= steps <= MAX_STEPS and -100 <= steering <= 100 and 0 <= speed <= 100):
            raise InputError(f"{steps} steps with {steering} and {speed} are too many or too much")
        action = np.array([0.01 * steering, 0.02 * speed - 1.0], np.float32)
        for _ in range(steps):
            if self._info["result"]:
                break
            self._info = self.env.step(action)[4]
            self._race = number, self._race[1] + 1
        return self._moment()

    def _moment(self) -> dict[str, Any]:
        info = self._info
        cars = np.column_stack([info["poses"], np.asarray(info["velocities"])[:, 0]])
        return {
            "number": self._race[0],
            "step": self._race[1],
            "cars": np.round(cars, 4).tolist(),
            "lead": float(info["lead"]),
            "result": str(self.env.outcome()["result"]) if info["result"] else "",
            "fault": int(info["fault"]),
        }


def drive_page(races: PersonDrive) -> str:
    """Return the page for the steering of a person; a server provides everything else."""
    title = f"You at the wheel against {races.opponent}"
    allowed = "connect-src 'self'"
    return rendered(
        "pcs_racing_agents.watch", "drive.html", title=title, allowed=allowed, step=TIME_STEP
    )


def make_person_drive(rival: Any, seed: int = 0, **arguments: Any) -> PersonDrive:
    """Return races against a competitor (arguments: :class:`pcs_racing.envs.drive.DriveEnv`)."""
    env = DriveEnv(opponent=rival, time_step=TIME_STEP, look_ahead=(), **arguments)
    return PersonDrive(env, competitor_name(rival), seed)
