"""Numbers of an environment's infos, their integer codes, and the labels of the codes.

Every environment uses the same names, and every value is a number or an array of numbers:

| name | number |
| --- | --- |
| `time` | time since the start, s |
| `progress` | progress along the race line, m |
| `lead` | lead over the opponent, or over the first of several, m; 0 for a single car |
| `crash`, `opponent_crash` | :class:`Crash` of the own car, and of any opponent (1) |
| `fault` | 1 if the own car is to blame for the crash, else 0 (1) |
| `cost` | 1.0 if the own car was at fault in the last step, else 0.0 |
| `overtakes` | number of overtakes by the own car |
| `result` | :class:`Result` of the episode |
| `opponent` | index of the episode's opponent in the environment; -1 if there is none |
| `move`, `opponent_move` | index of the last move; -1 before the first, and for a fixed policy |
| `policy` | index of the policy in the archive; -1 for a policy from outside |
| `laps` | complete laps of the own car from the start line; the first begins with the race |
| `lap_time`, `best_lap` | times of the last and the shortest of these laps, s; -1 without a lap |
| `lap_times` | times of the L laps of rules with laps, s, shape (L,); -1 for a lap not driven |
| `poses` | x, y (m) and heading (rad) of every car, the own car first, shape (N, 3) (2) |
| `velocities` | speed (m/s), yaw rate (rad/s) and slip angle (rad), shape (N, 3) (2) |
| `track` | number of the episode's track, if there are several |
| `obstacles` | number of obstacles on the track, if they are drawn |
| `mu`, `m`, ... | values drawn for the cars (:mod:`pcs_racing.envs.draws`), by field (3) |
| `handicap` | share of the commanded speed that the own car lacks, by ``front_pace`` of the rules |
| `action_mask` | 1 for each valid move (int8) |

(1) If contacts do not end a race, the code of a crash lasts as long as the contact, and ``fault``
is the number of faults so far. (2) Only at the control level. (3) One number for a
draw of all cars; else the values of all cars, the own car first, shape (N,). ``tyres`` is 0 for
linear and 1 for Pacejka; ``steer_noise`` is -1 for the noise of the rules.
"""

from collections.abc import Iterable, Mapping
from enum import IntEnum
from functools import cache, wraps
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.race.config import DT
from pcs_racing.race.state import BEST_LAP, LAP_COLUMNS, LAP_TIME, LAPS, NO_LAP, RaceState

_POSE, _MOTION = np.array([0, 1, 4]), np.array([3, 5, 6])  # columns of a car's state


class Crash(IntEnum):
    """Kind of a car's crash."""

    NONE = 0
    WALL = 1
    CAR = 2


class Result(IntEnum):
    """Result of an episode for a car."""

    RUNNING = 0
    """Episode in progress."""
    WIN = 1
    TIE = 2
    LOSS = 3
    CRASH = 4
    """No-contest crash, without a winner."""


def codes(kind: type[IntEnum]) -> dict[int, str]:
    """Return the labels of an enumeration by number."""
    return {member.value: member.name.lower() for member in kind}


def common_codes(opponents: Iterable[str]) -> dict[str, dict[int, str]]:
    """Return the labels of the codes in every environment's infos, given its opponents' names."""
    crash = codes(Crash)
    names = {-1: "none", **dict(enumerate(opponents))}
    return {"crash": crash, "opponent_crash": crash, "result": codes(Result), "opponent": names}


def of_players(values: NDArray[Any], players: int) -> NDArray[Any]:
    """Copy the players' values from an array of all cars.

    The array has the shape (B, N, ...), the result (B * players, ...).
    """
    return np.array(values[:, :players]).reshape(-1, *values.shape[2:])


def max_of_others(values: NDArray[Any]) -> NDArray[Any]:
    """Return the max value of the other cars for each car of B races, shape (B, N).

    A single car gets its own value.
    """
    number = values.shape[1]
    if number <= 2:
        return values[:, ::-1]
    ordered, out = np.sort(values, axis=1), np.repeat(values.max(axis=1)[:, None], number, axis=1)
    out[np.arange(len(values)), values.argmax(axis=1)] = ordered[:, -2]
    return out


def race_infos(
    races: RaceState, players: int, blamed: NDArray[np.bool_], handicaps: bool = False
) -> dict[str, NDArray[Any]]:
    """Return the infos of the players' cars in all races of a batch, shape (B * players, ...).

    The result is not included. ``blamed``, shape (B, N): True for a car at fault in the last step.
    ``handicaps``: True for rules that give handicaps.
    """
    progress, crash = races.progress, races.crash | races.contact
    others = max_of_others(crash) if races.number > 1 else np.zeros_like(crash)
    laps = races.laps[:, :players].reshape(-1, races.laps.shape[2])
    count = laps[:, LAPS].astype(np.int64)
    last, best = laps[:, LAP_TIME].copy(), laps[:, BEST_LAP].copy()
    last[count == 0] = best[count == 0] = NO_LAP
    by_laps = laps.shape[1] > LAP_COLUMNS
    return {
        "time": (races.tick * DT).repeat(players),
        "progress": progress[:, :players].flatten(),
        "lead": (progress - max_of_others(progress))[:, :players].flatten(),
        "crash": crash[:, :players].flatten().astype(np.int64),
        "opponent_crash": others[:, :players].flatten().astype(np.int64),
        "fault": races.fault[:, :players].flatten().astype(np.int64),
        "cost": blamed[:, :players].flatten().astype(np.float64),
        "overtakes": races.overtakes[:, :players].flatten(),
        "laps": count,
        "lap_time": last,
        "best_lap": best,
        **({"lap_times": of_players(_lap_times(races), players)} if by_laps else {}),
        **({"handicap": of_players(races.handicap, players)} if handicaps else {}),
    }


def all_poses(cars: NDArray[np.float64], players: int) -> dict[str, NDArray[np.float64]]:
    """Return poses and velocities of all cars of B races, each of shape (B * players, N, 3).

    The player's own car comes first.
    """
    races, number, size = cars.shape
    # Columns of flat rows: a gather along several axes would take five times as long.
    flat = cars.reshape(races, number * size)
    return {
        name: flat.take(columns, axis=1).reshape(-1, number, 3)
        for name, columns in _pose_columns(number, size, players).items()
    }


def own_first(values: NDArray[Any], players: int) -> NDArray[Any]:
    """Return the values of all cars, shape (B, N), for each player, own car first.

    The result has the shape (B * players, N).
    """
    number = values.shape[1]
    return values[:, _own_first(number, players)].reshape(-1, number)


def _own_first(number: int, players: int) -> NDArray[np.int64]:
    return np.array(
        [[player, *(car for car in range(number) if car != player)] for player in range(players)]
    )


@cache
def _pose_columns(number: int, size: int, players: int) -> dict[str, NDArray[np.int64]]:
    first = size * _own_first(number, players)[..., None]
    return {"poses": first + _POSE, "velocities": first + _MOTION}


def pose_info(cars: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return poses and velocities in the order of the cars; ``cars`` has the shape (..., N, 7)."""
    return {"poses": cars.take(_POSE, axis=-1), "velocities": cars.take(_MOTION, axis=-1)}


def race_results(
    winner: NDArray[np.int8], crashed: NDArray[np.bool_], players: int
) -> NDArray[np.int64]:
    """Return the :class:`Result` of finished races for each player, shape (B, players)."""
    # A race without a winner was a tie or a no-contest crash.
    unwon = np.where(crashed, Result.CRASH, Result.TIE)
    cars = np.arange(players)
    won = np.where(winner[:, None] == cars, Result.WIN, Result.LOSS)
    return np.where(winner[:, None] < 0, unwon[:, None], won).astype(np.int64)


def race_info(
    races: RaceState, race: int, car: int, blamed: bool, handicaps: bool = False
) -> dict[str, Any]:
    """Return the infos of one car in one race as plain numbers, and lap times as an array.

    This is ten times faster than `race_infos` with arrays of length one.
    """
    progress = races.progress[race].tolist()
    crashes = (races.crash[race] | races.contact[race]).tolist()
    own, crash = progress.pop(car), crashes.pop(car)  # the other cars' remain
    laps = races.laps[race, car].tolist()
    begun = laps[LAPS] != 0.0
    return {
        "time": races.tick.item(race) * DT,
        "progress": own,
        "lead": own - max(progress, default=own),
        "crash": crash,
        "opponent_crash": max(crashes, default=0),
        "fault": races.fault.item(race, car),
        "cost": float(blamed),
        "overtakes": races.overtakes.item(race, car),
        "laps": int(laps[LAPS]),
        "lap_time": laps[LAP_TIME] if begun else NO_LAP,
        "best_lap": laps[BEST_LAP] if begun else NO_LAP,
        **({"lap_times": _lap_times(races)[race, car]} if len(laps) > LAP_COLUMNS else {}),
        **({"handicap": races.handicap.item(race, car)} if handicaps else {}),
    }


def _lap_times(races: RaceState) -> NDArray[np.float64]:
    """Return the time of each lap, shape (B, N, L); a NaN would make equal infos unequal."""
    return np.nan_to_num(races.lap_times, nan=NO_LAP)


class InfoRow(dict[str, Any]):
    """Info of one environment of a batch: plain numbers and rows of arrays, without masks.

    It is filled from the arrays of the batch at its first use: most infos of a training are never
    read.
    """

    __slots__ = ("_columns", "_row")

    def __init__(self, columns: Mapping[str, NDArray[Any]], row: int) -> None:
        self._columns: Mapping[str, NDArray[Any]] | None = columns
        self._row = row

    def get(self, name: str, default: Any = None) -> Any:
        """Return a value, or the default; a missing name fills nothing."""
        if self._columns is not None and name not in self._columns:
            return default
        return super().get(name, default) if self._columns is None else self[name]

    def __contains__(self, name: object) -> bool:
        return super().__contains__(name) if self._columns is None else name in self._columns

    def fill(self) -> None:
        """Take the values from the arrays."""
        columns, self._columns = self._columns, None
        for name, values in (columns or {}).items():
            one = values.item(self._row) if values.ndim == 1 else values[self._row]
            super().__setitem__(name, one)

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (self.copy(),)  # a plain dictionary, without the arrays


def _after_filling(name: str) -> Any:
    method = getattr(dict, name)

    @wraps(method)
    def call(self: InfoRow, *arguments: Any, **named: Any) -> Any:
        if self._columns is not None:
            self.fill()
        return method(self, *arguments, **named)

    return call


for _name in (
    *("__delitem__", "__eq__", "__getitem__", "__ior__", "__iter__", "__len__"),
    *("__ne__", "__or__", "__repr__", "__reversed__", "__ror__", "__setitem__", "clear", "copy"),
    *("items", "keys", "pop", "popitem", "setdefault", "update", "values"),
):
    setattr(InfoRow, _name, _after_filling(_name))


def rows_of(infos: Mapping[str, Any], rows: Iterable[int] | None = None) -> list[InfoRow]:
    """Return the infos of some environments of a batch, by default of all, without masks."""
    columns = {
        name: values for name, values in infos.items() if not name.startswith(("_", "final_"))
    }
    given = range(len(next(iter(columns.values())))) if rows is None else rows
    return [InfoRow(columns, row) for row in given]


def words(info: Mapping[str, Any], names: Mapping[str, Mapping[int, str]]) -> dict[str, Any]:
    """Replace the codes in the info of one environment by their labels, without masks and arrays.

    ``names`` is ``env.metadata["codes"]``: labels by number, for each entry with codes.
    """
    return {
        name: names[name][int(value)] if name in names else value
        for name, value in info.items()
        if not isinstance(value, np.ndarray)
    }
