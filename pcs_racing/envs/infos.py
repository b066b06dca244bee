"""The numbers of an environment's infos: their codes, and their words for people.

Every environment uses the same names, and every value is a number or an array of numbers:

| name | number |
| --- | --- |
| `time` | s since the start |
| `progress`, `lead` | m along the race line; ahead of the opponent, or of the first of several; alone 0 |
| `crash`, `opponent_crash` | :class:`Crash`, of any opponent; where contacts end no race, while the contact lasts |
| `fault` | 1 if the own car is to blame for the crash, else 0; where contacts end no race, its faults so far |
| `overtakes` | how often the own car passed another one |
| `result` | :class:`Result` |
| `opponent` | index of the episode's opponent among those of the environment; -1 if there is none |
| `move`, `opponent_move` | index of the last move; -1 before the first, and for a driver, which makes none |
| `race` | of a match: races that are over |
| `race_result` | of a match: :class:`Result` of the race that ended last |
| `score`, `opponent_score` | of a match: races won so far, a tie counting half |
| `policy` | index of the policy in the archive; -1 for a driver from outside |
| `laps` | complete laps of the own car, counted from the start line; the first one begins with the race |
| `lap_time`, `best_lap` | s, of the last and the shortest of these laps; -1 if there is none |
| `poses` | of the control level: x, y (m) and heading (rad) of every car, the own one first, shape (N, 3) |
| `velocities` | likewise: speed (m/s), yaw rate (rad/s) and slip angle (rad) |
| `track` | number of the episode's circuit, where there are several |
| `obstacles` | how many stand on the track, if they are drawn |
| `friction`, `mass`, `steering_delay`, `steering_noise`, `lidar_noise` | what was drawn for the episode, if it was |
| `action_mask` | 1 for each move that may be made (int8) |
"""

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.race.config import DT
from pcs_racing.race.state import BEST_LAP, LAP_TIME, LAPS, NO_LAP, RaceState

_POSE, _MOTION = np.array([0, 1, 4]), np.array([3, 5, 6])  # columns of a car's state


class Crash(IntEnum):
    """How a car crashed."""

    NONE = 0
    WALL = 1
    CAR = 2


class Result(IntEnum):
    """How an episode ended for a car."""

    RUNNING = 0
    """It goes on."""
    WIN = 1
    TIE = 2
    LOSS = 3
    CRASH = 4
    """A no-contest crash: nobody won."""


def codes(kind: type[IntEnum]) -> dict[int, str]:
    """Words of an enumeration by number."""
    return {member.value: member.name.lower() for member in kind}


def common_codes(opponents: Iterable[str]) -> dict[str, dict[int, str]]:
    """Words of the infos of every environment that are codes, from the names of its opponents."""
    crash = codes(Crash)
    names = {-1: "none", **dict(enumerate(opponents))}
    return {"crash": crash, "opponent_crash": crash, "result": codes(Result), "opponent": names}


def of_players(values: NDArray[Any], players: int) -> NDArray[Any]:
    """Copy what belongs to the players, shape (B * players, ...), out of an array of all cars, shape (B, N, ...)."""
    return np.array(values[:, :players]).reshape(-1, *values.shape[2:])


def most_of_others(values: NDArray[Any]) -> NDArray[Any]:
    """The largest value of the other cars for each car of B races, shape (B, N); of a car alone its own."""
    number = values.shape[1]
    if number <= 2:
        return values[:, ::-1]
    ordered, out = np.sort(values, axis=1), np.repeat(values.max(axis=1)[:, None], number, axis=1)
    out[np.arange(len(values)), values.argmax(axis=1)] = ordered[:, -2]
    return out


def race_infos(races: RaceState, players: int) -> dict[str, NDArray[Any]]:
    """What is told of the players' cars in all races of a batch, apart from the result, shape (B * players,)."""
    crash = (races.crash | races.contact).astype(np.int64)
    of_cars = {
        "progress": races.progress,
        "lead": races.progress - most_of_others(races.progress),
        "crash": crash,
        "opponent_crash": most_of_others(crash) if races.number > 1 else np.zeros_like(crash),
        "fault": races.fault.astype(np.int64),
        "overtakes": races.overtakes,
        "laps": races.lap_count,
        "lap_time": races.lap_time,
        "best_lap": races.best_lap,
    }
    infos = {name: of_players(values, players) for name, values in of_cars.items()}
    return {"time": np.repeat(races.tick * DT, players), **infos}


def all_poses(cars: NDArray[np.float64], players: Iterable[int]) -> dict[str, NDArray[np.float64]]:
    """Where all cars of B races are and how they move, shape (B * players, N, 3) each: the player's own car first."""
    number = cars.shape[1]
    order = [[player, *(car for car in range(number) if car != player)] for player in players]
    # The order of columns first: rows of three numbers are gathered faster than of seven.
    return {name: values[:, order].reshape(-1, number, 3) for name, values in pose_info(cars).items()}


def pose_info(cars: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """The same in the order of the cars, whose states have the shape (..., N, 7)."""
    return {"poses": cars.take(_POSE, axis=-1), "velocities": cars.take(_MOTION, axis=-1)}


def race_results(winner: NDArray[np.int8], crashed: NDArray[np.bool_], players: int) -> NDArray[np.int64]:
    """How races that are over ended for each player: :class:`Result`, shape (B, players)."""
    # Without a winner it was a tie, or a crash that the rules give to nobody.
    nobody = np.where(crashed, Result.CRASH, Result.TIE)
    cars = np.arange(players)
    won = np.where(winner[:, None] == cars, Result.WIN, Result.LOSS)
    return np.where(winner[:, None] < 0, nobody[:, None], won).astype(np.int64)


def race_info(races: RaceState, race: int, car: int) -> dict[str, Any]:
    """Return the same of one car in one race, as plain numbers: in a tenth of the time that arrays of one take."""
    others = [other for other in range(races.number) if other != car]
    progress = races.progress.item(race, car)
    crashes = [races.crash.item(race, k) | races.contact.item(race, k) for k in (car, *others)]
    laps = int(races.laps.item(race, car, LAPS))
    return {
        "time": races.tick.item(race) * DT,
        "progress": progress,
        "lead": progress - max([races.progress.item(race, other) for other in others], default=progress),
        "crash": crashes[0],
        "opponent_crash": max(crashes[1:], default=0),
        "fault": races.fault.item(race, car),
        "overtakes": races.overtakes.item(race, car),
        "laps": laps,
        "lap_time": races.laps.item(race, car, LAP_TIME) if laps else NO_LAP,
        "best_lap": races.laps.item(race, car, BEST_LAP) if laps else NO_LAP,
    }


def words(info: Mapping[str, Any], names: Mapping[str, Mapping[int, str]]) -> dict[str, Any]:
    """Replace the codes in the info of one environment by their words; masks and arrays are left out.

    The names are ``env.metadata["codes"]``: words by number, for each entry that is a code.
    """
    return {
        name: names[name][int(value)] if name in names else value
        for name, value in info.items()
        if not isinstance(value, np.ndarray)
    }
