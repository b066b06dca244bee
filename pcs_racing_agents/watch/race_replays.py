"""Replays of races for the viewer, with the moves in the Policy Characteristic Space.

A replay of the viewer is a smaller form of a :mod:`pcs_racing.race.replay`: track data is stored
once for all races, plans are stored every 0.2 s in centimetres, and data not drawn by the page is
omitted.
"""

import re
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.packing import COARSE, FINE, pack, pack_paths, pack_segments
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.race.replay import Replay, plain_parts, safe_json
from pcs_racing_agents.agents.observing import opponent, step_count
from pcs_racing_agents.base.progress import Progress
from pcs_racing_agents.tournament import Pairing, RaceRow, repeat_race
from pcs_racing_agents.watch.explain import mark_moves
from pcs_racing_agents.watch.pcs_picture import axis_limits, in_units, plane
from pcs_racing_agents.watch.results_folder import ResultsFolder
from pcs_racing_agents.watch.view_server import Answer, error_answer

PLACES = 4000  # resolution of positions: steps across the picture
PLAN_SKIP = 2  # every second plan is stored
MAX_PAIRINGS = 64
MAX_ANSWERS = 200  # cached in memory, some 40 kB each
_RACE = re.compile(r"/race/([0-9]{1,7})")

Floats = NDArray[np.float64]


class RaceRepeater:
    """A repeater of a results folder's races, with their shared data; not thread-safe."""

    def __init__(self, results: ResultsFolder) -> None:
        self.results = results
        #: Tracks of the races so far, by name (:func:`circuit_values`).
        self.circuits: dict[str, dict[str, Any]] = {}
        #: Policy Characteristic Space (:func:`space_values`); None before the first race.
        self.space: dict[str, Any] | None = None
        self._pairing = lru_cache(maxsize=MAX_PAIRINGS)(self._make_pairing)
        self._json = lru_cache(maxsize=MAX_ANSWERS)(self._make_json)

    def answer(self, path: str) -> Answer:
        """Answer ``/race/NUMBER`` with the race, its track and space as JSON, or ``error``."""
        match, count = _RACE.fullmatch(path), len(self.results.races)
        if match is None or int(match.group(1)) >= count:
            return error_answer(404, f"there is / and /race/NUMBER here, from 0 to {count - 1}")
        try:
            return Answer(200, self._json(int(match.group(1))))
        except (InputError, ModuleNotFoundError, OSError) as error:
            return error_answer(409, str(error))

    def _make_json(self, number: int) -> bytes:
        race, track = self.drive(number), self.results.row(number).track
        circuit = [track, self.circuits[track]]
        return safe_json({"race": race, "circuit": circuit, "space": self.space}).encode()

    def _make_pairing(self, track: str, ego: str, opponent: str, seed: int) -> Pairing:
        return self.results.pairing(RaceRow(track=track, ego=ego, opponent=opponent, seed=seed))

    def drive(self, number: int) -> dict[str, Any]:
        """Repeat the race on a line of the results, and return its data for the page."""
        row = self.results.row(number)
        pairing = self._pairing(*_pair(row))
        recording = repeat_race(pairing, row.race, candidates=False)
        played, game = recording.played, recording.game
        # An edited folder is detected by the lead.
        self.results.check_lead(number, played.lead[0])
        replay = mark_moves(recording.replay, played, game.move_names, game.config.ends)
        if self.space is None:
            self.space = space_values(game.archive, game.move_names)
        self.circuits.setdefault(row.track, circuit_values(replay))
        axes = len(game.archive.characteristics)
        steps = range(step_count(played.observations[:, 0], axes))
        # Observed steps after a crash are zeros; the last number of a step marks it as complete.
        blocks = played.observations[0, :, :-1].reshape(2, len(steps), -1)
        observations = (played.observations[:, car] for car in range(2))
        estimates = np.array(
            [
                [opponent(observation, axes, step)[0] for step in steps]
                for observation in observations
            ]
        )
        estimates = np.where(blocks[..., -1:] > 0.5, estimates.astype(np.float64), np.nan)
        values = race_values(replay)
        values["space"] = {
            "ends": game.config.ends,
            "policies": played.path[0].tolist(),
            "made": played.moves.codes[0].tolist(),
            "seen": _places(
                self.space, in_units(game.archive, estimates)[..., list(plane(game.archive))]
            ),
        }
        return values

    def drive_all(
        self, numbers: Iterable[int], progress: Progress | None = None
    ) -> dict[int, dict[str, Any]]:
        """Repeat the races of several lines, grouped by pair, and return their data."""
        rows = self.results.row
        order = sorted(numbers, key=lambda number: (_pair(rows(number)), number))
        races = {}
        for number in order:
            races[number] = self.drive(number)
            if progress is not None:
                progress(len(races), len(order), rows(number).track)
        return races


def _pair(row: RaceRow) -> tuple[str, str, str, int]:
    return (row.track, row.ego, row.opponent, row.seed)


def race_values(replay: Replay) -> dict[str, Any]:
    """Return the data of a replay without its track, as plain values for the page's JSON.

    Together with :func:`circuit_values` this is a replay in the format of
    :mod:`pcs_racing.race.replay`.
    """
    # The page draws neither of the last two columns; zeros pack to nothing.
    drawn = np.concatenate([replay.cars[..., :5], np.zeros((*replay.cars.shape[:2], 2))], axis=-1)
    values: dict[str, Any] = {
        **plain_parts(replay),
        "plan_dt": PLAN_SKIP * replay.plan_dt,
        "cars": pack(drawn, FINE, [0, 0]),
        "progress": pack(replay.progress, COARSE, [0, 0]),
    }
    if replay.paths is not None:
        plans = replay.paths[::PLAN_SKIP].copy()
        plans[..., 2] = np.where(np.isnan(plans[..., 2]), np.nan, 0.0)
        values["paths"] = pack_paths(plans, COARSE)
    return values


def circuit_values(replay: Replay) -> dict[str, Any]:
    """Return the data of a replay's track, as plain values for the page's JSON."""
    values = {"walls": pack_segments(replay.walls), "line": pack(replay.line, FINE, [0, 0])}
    if replay.line_speed is not None:
        values["line_speed"] = pack(replay.line_speed, COARSE, [0])
    return values


def space_values(archive: PolicyArchive, moves: Sequence[str]) -> dict[str, Any]:
    """Return the Policy Characteristic Space as plain values for the page's JSON.

    Positions are in steps of 1/4000 of the picture, from the left and lower edge.
    """
    columns = plane(archive)
    kinds = get_characteristics(archive.characteristics)
    axes = []
    for column in columns:
        low, high = axis_limits(archive, column, 0.5)
        axes.append(
            {"name": kinds[column].name, "unit": kinds[column].unit, "low": low, "high": high}
        )
    space: dict[str, Any] = {"archive": archive.name, "axes": axes, "moves": list(moves)}
    explored = archive.explored_coordinates[:, list(columns)]
    low_high = np.array([[axis["low"], axis["high"]] for axis in axes])
    inside = np.all((explored >= low_high[:, 0]) & (explored <= low_high[:, 1]), axis=1)
    space["points"] = _places(space, archive.coordinates[:, list(columns)])
    space["explored"] = pack(np.array(_places(space, explored[inside]), float).reshape(-1, 2), 1)
    space["crash"] = (
        None if archive.own_crash is None else np.round(100.0 * archive.own_crash, 1).tolist()
    )
    return space


def _places(space: dict[str, Any], points: Floats) -> Any:
    """Return points (..., 2) in axis units as nested lists of whole steps; null for NaN."""
    low, high = (np.array([axis[key] for axis in space["axes"]]) for key in ("low", "high"))
    steps = PLACES * (points - low) / (high - low)
    missing = np.isnan(steps).any(axis=-1)
    # Clipped: an estimate can lie far outside the picture; whole steps are short in JSON.
    whole = np.rint(np.clip(np.nan_to_num(steps), -1e6, 1e6)).astype(np.int64).tolist()
    return _without(whole, missing.tolist())


def _without(values: Any, missing: Any) -> Any:
    """Replace missing innermost lists by None."""
    if isinstance(missing, bool):
        return None if missing else values
    return [_without(value, empty) for value, empty in zip(values, missing, strict=True)]
