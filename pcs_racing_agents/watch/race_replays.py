"""Replays of races for the viewer, with the moves in the Policy Characteristic Space.

A replay of the viewer is a smaller form of a :mod:`pcs_racing.race.replay`: walls and race line are
stored once for all races, plans every 0.2 s, and no times to collision.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.errors import InputError
from pcs_racing.base.packing import pack
from pcs_racing.base.typing import Floats
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.race.replay import page_values, safe_json
from pcs_racing_agents.agents.observing import opponent, step_count
from pcs_racing_agents.base.progress import Progress
from pcs_racing_agents.tournament import RaceRow, RaceTable, repeat_race
from pcs_racing_agents.watch.explain import mark_moves
from pcs_racing_agents.watch.pcs_picture import axis_limits, in_units, plane
from pcs_racing_agents.watch.results_folder import ResultsFolder
from pcs_racing_agents.watch.view_server import Answer, error_answer

PLAN_SKIP = 2  # every second plan is stored
MAX_PAIRINGS = 64
_RACE = re.compile(r"/race/([0-9]{1,7})")


class RaceRepeater:
    """A repeater of a results folder's races, with their shared data; not thread-safe."""

    def __init__(self, results: ResultsFolder) -> None:
        self.results = results
        #: Walls and lines of the tracks of the races so far, by name.
        self.circuits: dict[str, dict[str, Any]] = {}
        #: Policy Characteristic Space (:func:`space_values`); None before the first race.
        self.space: dict[str, Any] | None = None
        self._pairing = lru_cache(maxsize=MAX_PAIRINGS)(results.pairing)

    def answer(self, path: str) -> Answer:
        """Answer ``/race/NUMBER`` with the race, its track and space as JSON, or ``error``."""
        match, count = _RACE.fullmatch(path), len(self.results.races)
        if match is None or int(match.group(1)) >= count:
            return error_answer(404, f"there is / and /race/NUMBER here, from 0 to {count - 1}")
        number = int(match.group(1))
        track = self.results.row(number).track
        try:
            race = self.drive(number)
        except (InputError, ModuleNotFoundError, OSError) as error:
            return error_answer(409, str(error))
        circuit = [track, self.circuits[track]]
        values = {"race": race, "circuit": circuit, "space": self.space}
        return Answer(200, safe_json(values).encode())

    def drive(self, number: int) -> dict[str, Any]:
        """Repeat the race on a line of the results, and return its data for the page."""
        row = self.results.row(number)
        pair = RaceRow(track=row.track, ego=row.ego, opponent=row.opponent, seed=row.seed)
        recording = repeat_race(self._pairing(pair), row.race, candidates=False)
        played, game = recording.played, recording.game
        # An edited folder is detected by the lead.
        self.results.check_lead(number, played.lead[0])
        replay = mark_moves(recording.replay, played, game.moves, game.config.ends)
        if replay.paths is not None:
            replay = replace(replay, paths=replay.paths[::PLAN_SKIP])
        replay = replace(replay, plan_dt=PLAN_SKIP * replay.plan_dt, ittc=None)
        values = page_values(replay)
        self.circuits[row.track] = {part: values.pop(part) for part in ("walls", "line")}
        if self.space is None:
            self.space = space_values(game.archive, game.moves)
        values["space"] = {
            "ends": game.config.ends,
            "policies": played.path[0].tolist(),
            "made": played.moves.codes[0].tolist(),
            "seen": [_seen(game.archive, played, car) for car in range(2)],
        }
        return values

    def drive_all(
        self, numbers: Iterable[int], progress: Progress | None = None
    ) -> dict[int, dict[str, Any]]:
        """Repeat the races of several lines, and return their data."""
        races, order = {}, sorted(numbers)  # races of a pair follow each other
        for number in order:
            races[number] = self.drive(number)
            if progress is not None:
                progress(len(races), len(order), self.results.row(number).track)
        return races


def _seen(archive: PolicyArchive, played: RaceTable, car: int) -> list[list[float] | None]:
    """Return the places of the opponent that a car measured in each step; None after a crash."""
    assert played.observations is not None
    observation, axes = played.observations[:, car], len(archive.characteristics)
    steps = step_count(observation, axes)
    # Observed steps after a crash are zeros; the last number of a step marks it as complete.
    complete = observation[0, :-1].reshape(steps, -1)[:, -1] > 0.5
    measured = [opponent(observation, axes, step)[0] for step in range(steps)]
    places = _places(archive, in_units(archive, measured))
    return [place if known else None for place, known in zip(places, complete, strict=True)]


def space_values(archive: PolicyArchive, moves: Sequence[str]) -> dict[str, Any]:
    """Return the Policy Characteristic Space as plain values for the page's JSON.

    Places are shares of the picture's width and height, from the left and lower edge.
    """
    columns, kinds = plane(archive), get_characteristics(archive.characteristics)
    low, high = _limits(archive)
    axes = [
        {"name": kinds[column].name, "unit": kinds[column].unit, "low": low[k], "high": high[k]}
        for k, column in enumerate(columns)
    ]
    explored = np.array(_places(archive, archive.explored_coordinates)).reshape(-1, 2)
    shares = archive.own_crash
    return {
        "archive": archive.name,
        "axes": axes,
        "moves": list(moves),
        "points": _places(archive, archive.coordinates),
        "explored": pack(explored[((explored >= 0.0) & (explored <= 1.0)).all(axis=1)], 4000),
        "crash": None if shares is None else np.round(100.0 * shares, 1).tolist(),
    }


def _limits(archive: PolicyArchive) -> Floats:
    """Return the lower and upper limits of the picture's axes, shape (2, 2)."""
    return np.transpose([axis_limits(archive, column, 0.5) for column in plane(archive)])


def _places(archive: PolicyArchive, points: ArrayLike) -> Any:
    """Return points in the characteristics' units as places in the picture: nested lists."""
    low, high = _limits(archive)
    shares = (np.asarray(points)[..., list(plane(archive))] - low) / (high - low)
    return np.round(shares, 4).tolist()
