"""A race in which a person steers car 0, fifty times a second, against an agent or a driver in car 1."""

import re
import threading
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing.envs.drive import DriveEnv
from pcs_racing.game.competitor import competitor_name
from pcs_racing.race.replay_files import safe_json
from pcs_racing_agents.view.view_page import page_of
from pcs_racing_agents.view.view_server import Answer, error_answer

TIME_STEP = 0.02  # s
MOST_STEPS = 25  # in an answer: half a second, after which a page that was away goes on

_BEGIN = re.compile(r"/begin/([0-9]{1,6})")
_DRIVE = re.compile(r"/drive/([0-9]{1,6})/([0-9]{1,6})/([0-9]{1,2})/(-?[0-9]{1,3})/([0-9]{1,3})")


@dataclass(eq=False)
class PersonDrive:
    """The race that a page drives; race ``k`` has a start of its own. Equal commands give equal races."""

    env: DriveEnv  #: Of steps of :data:`TIME_STEP`, with actions in [-1, 1].
    opponent: str  #: Its name.
    seed: int = 0  #: Of race 0; race ``k`` has this one more ``k`` times.
    _race: tuple[int, int] = field(init=False, default=(-1, 0))  # its number, and the steps driven
    _info: dict[str, Any] = field(init=False, default_factory=dict)
    _lock: Any = field(init=False, default_factory=threading.Lock)

    def answer(self, path: str) -> Answer:
        """Answer ``/begin/K``, and ``/drive/K/STEP/STEPS/STEERING/SPEED``, with the race at that moment as JSON.

        ``STEP`` says from which step on ``STEPS`` are driven, with the steering from -100 (right) to 100 (left) and the
        speed from 0 to 100 as shares of the largest.
        """
        begin, on = _BEGIN.fullmatch(path), _DRIVE.fullmatch(path)
        try:
            with self._lock:
                if begin:
                    return Answer(200, safe_json(self._begin(int(begin.group(1)))).encode())
                if on:
                    return Answer(200, safe_json(self._drive(*map(int, on.groups()))).encode())
        except InputError as error:
            return error_answer(409, str(error))
        return error_answer(404, "there is /, /begin/NUMBER and /drive/NUMBER/STEP/STEPS/STEERING/SPEED here")

    def _begin(self, number: int) -> dict[str, Any]:
        self._info = self.env.reset(seed=self.seed + number)[1]
        self._race = number, 0
        track = self.env.batch.track
        walls, line = (np.round(part, 3).tolist() for part in (track.arrays.walls, track.line[:, :2]))
        return {**self._moment(), "walls": walls, "line": line, "track": track.name, "opponent": self.opponent}

    def _drive(self, number: int, step: int, steps: int, steering: int, speed: int) -> dict[str, Any]:
        if (number, step) != self._race:
            raise InputError(f"race {number} is not at step {step}: another page drives here; begin a race again")
        if not (1 <= steps <= MOST_STEPS and -100 <= steering <= 100 and 0 <= speed <= 100):
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
    """Return the page on which a person steers; it asks a server for everything else."""
    title = f"You at the wheel against {races.opponent}"
    return page_of("drive.html", title, "connect-src 'self'", {"/*step*/": str(TIME_STEP)})


def make_person_drive(rival: Any, seed: int = 0, **arguments: Any) -> PersonDrive:
    """Return races against a competitor; the ``arguments`` are those of :class:`pcs_racing.envs.drive.DriveEnv`."""
    env = DriveEnv(opponent=rival, time_step=TIME_STEP, look_ahead=(), **arguments)
    return PersonDrive(env, competitor_name(rival), seed)
