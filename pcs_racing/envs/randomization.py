"""Domain randomization of the episodes of a batch: track, obstacles, cars, sensors."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import ConfigError, InputError
from pcs_racing.base.settings import ANYTHING, Checked, Settings
from pcs_racing.car.vehicle import (
    COMMAND_PERIOD,
    F1TENTH,
    OPPONENT_DELAY,
    SPEED_DELAY,
    STEER_DELAY,
    VehicleParams,
    load_vehicle,
    load_vehicles,
)
from pcs_racing.envs.batch import FREE, Generators, Rows, check_part, check_within
from pcs_racing.envs.circuits import Circuits
from pcs_racing.envs.draws import (
    PARAMETERS,
    Randomization,
    as_number,
    cars_at_ends,
    labels,
    load_randomization,
    with_values,
)
from pcs_racing.envs.infos import own_first
from pcs_racing.race.conditions import RaceConditions, vehicle_rows
from pcs_racing.race.driving import AS_THE_SETUP
from pcs_racing.race.races import RaceSetup, queue_size, start_races
from pcs_racing.race.start_grid import Starts, places_of_grid
from pcs_racing.track.moving import BOX, MOTION
from pcs_racing.track.track import Track


def _vehicles(_: str, value: Any) -> Any:
    return (
        tuple(map(load_vehicle, value)) if isinstance(value, list | tuple) else load_vehicle(value)
    )


def _obstacles(_: str, value: Any) -> Any:
    if value is None:  # so that episodes without obstacles load none
        return None
    from pcs_racing.envs.obstacles import load_obstacles

    return load_obstacles(value)


def _function(name: str, value: Any) -> Any:
    if value is not None and not callable(value):
        raise ConfigError(f"{name} is {value!r:.80}; it must be a function of a step")
    return value


@dataclass(frozen=True, eq=False)
class EpisodeOptions(Settings):
    """Arguments that all environments share."""

    track: Annotated[
        Any,
        ANYTHING,
        "Name of a shipped circuit, a map folder, or a track. Of a list one is drawn for each"
        ' episode; with "random" each episode is driven on a newly generated circuit, or as'
        " :class:`pcs_racing.envs.random_circuits.RandomCircuits` says.",
    ] = "Tarnfjord"
    vehicle: Annotated[
        Any,
        Checked(_vehicles),
        "Parameters of all cars, or a list with the parameters of each car: a shipped car's name"
        ' ("f1tenth", "f1tenth-pacejka", "forzaeth-nuc2"), or a dict or a YAML file of the values'
        " that differ from F1TENTH's (:class:`pcs_racing.car.vehicle.VehicleParams`), such as"
        ' ``{"mu": 0.8}``.',
    ] = F1TENTH
    randomize: Annotated[
        Randomization | None,
        Checked(lambda _, value: load_randomization(value)),
        "Ranges or distributions of fields of the cars, drawn for each episode, for all cars or"
        " for each (:mod:`pcs_racing.envs.draws`): a dict or a YAML file, such as"
        ' ``{"mu": [0.7, 1.1], "each": {"steer_lag": [0.0, 0.1]}}``.',
    ] = None
    obstacles: Annotated[
        Any,
        Checked(_obstacles),
        "Boxes and circles on the track, at rest or moving, drawn for each episode: their number,"
        " or their settings (:class:`pcs_racing.envs.obstacles.Obstacles`) as a dict or a YAML"
        " file. The lidar sees them, a contact is a crash as into a wall, and the lattice planner"
        " avoids most.",
    ] = None
    reward: Annotated[
        Callable[..., Any] | None,
        Checked(_function),
        "Function of a step (:class:`pcs_racing.envs.batch.Step`) that returns the reward of each"
        " player, shape (episodes, players), in place of the environment's reward.",
    ] = None
    render_mode: Annotated[
        str | None,
        ANYTHING,
        '"rgb_array", for frames of `render`, or "human", for a window. In a duel a frame shows how'
        ' a step ended; with "rgb_array_list" it gets all frames since it was last called, or since'
        " the reset, 25 for each second of racing (:class:`pcs_racing.envs.video.RecordRaces` makes"
        " a video of them).",
    ] = None
    view: Annotated[
        str,
        ANYTHING,
        '"track", "both" (all cars stay in sight), or "car_0" to "car_7": content of a frame.',
    ] = "both"
    render_size: Annotated[tuple[int, int], ANYTHING, "Width and height of a frame in pixels."] = (
        960,
        640,
    )

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """Return the defaults of all arguments by name."""
        return {one.name: one.default for one in fields(cls)}

    @classmethod
    def read(cls, arguments: Mapping[str, Any]) -> Self:
        """Return the configuration with these arguments, whose names are known."""
        return cls(**arguments)


NO_BOXES = np.empty((0, len(BOX) + len(MOTION)))


def _with_obstacles(track: Track, boxes: NDArray[np.float64]) -> Track:
    from pcs_racing.track.obstacles import with_obstacles

    return with_obstacles(track, boxes)


class EpisodeRandomization:
    """Tracks, obstacles and cars of a batch of episodes, with their random draws."""

    def __init__(self, episodes: int, options: EpisodeOptions, *, cars: int = 2) -> None:
        self.cars = load_vehicles(options.vehicle, cars)  #: Cars without random draws.
        self.ranges = options.randomize or Randomization()
        self.ranges.check_cars(cars)
        try:  # a drawn mass scales the inertia, which has limits of its own
            cars_at_ends(self.ranges, self.cars)
        except ConfigError as error:
            raise ConfigError(f"randomize: at an end of the draws {error}") from None
        self._queue = queue_size((*self.cars, self.ranges.max_delays))
        self.episodes = episodes
        self.circuits = Circuits(options.track, episodes)
        #: shape (episodes, cars, 48): Parameter rows of the cars of each episode.
        self.vehicles = vehicle_rows(self.cars, episodes)  # writable: one compiled type
        #: Values drawn for each episode, by name, each of shape (episodes,), or (episodes, cars)
        #: if drawn per car.
        self.drawn = {
            name: np.zeros((episodes, cars) if name in self.ranges.own else episodes)
            for name in self.ranges.names
        }
        self.obstacles = options.obstacles
        #: Obstacles of each episode, shape (K, 7) (:data:`pcs_racing.track.moving.BOX` and
        #: ``MOTION``).
        self.boxes = [NO_BOXES] * episodes
        self._tracks: list[Track | None] = [None] * episodes  # tracks with obstacles
        self._blocked = False  # True from the first obstacle on

    @property
    def codes(self) -> dict[str, Mapping[int, str]]:
        """Labels of the infos with codes."""
        tracks = {"track": self.circuits.codes} if self.circuits.several else {}
        named = {name: labels(name) for name in self.drawn}
        return tracks | {name: known for name, known in named.items() if known}

    def track(self, episode: int) -> Track:
        """Return the track of an episode, with its obstacles."""
        return self._tracks[episode] or self.circuits.track(int(self.circuits.number[episode]))

    def widest(self, players: int) -> tuple[VehicleParams, ...]:
        """Return the first ``players`` cars, with both ends of the draws of steering and speed."""
        names = "steer_max", "v_min", "v_max"
        low, high = cars_at_ends(self.ranges, self.cars[:players], *names)
        return tuple(dict.fromkeys((*low, *high)))

    @property
    def draws_bodies(self) -> bool:
        """True if the widths or lengths of cars are drawn."""
        return not {"width", "length"}.isdisjoint(self.drawn)

    def check_bodies(self, setup: RaceSetup, lines: NDArray[np.float64]) -> None:
        """Refuse drawn widths and lengths that do not fit on a grid at one of the start lines."""
        if not self.draws_bodies:
            return
        _, largest = cars_at_ends(self.ranges, self.cars, "width", "length")
        places, setup = places_of_grid(len(largest)), replace(setup, vehicles=tuple(largest))
        starts = Starts(np.repeat(lines, places), np.tile(np.arange(places), len(lines)))
        try:
            start_races(setup, starts, np.zeros(len(starts), np.uint64))
        except InputError:
            width, length = (
                max(getattr(car, end) for car in largest) for end in ("width", "length")
            )
            raise ConfigError(
                f"randomize draws cars of up to {width:g} x {length:g} m; on the grid of track"
                f" {setup.track.name!r} such a car would start in a wall or in another car: draw"
                " smaller ones"
            ) from None

    def place_obstacles(
        self,
        rows: Rows,
        starts: NDArray[np.float64],
        generators: Generators,
        given: Sequence[NDArray[np.float64]] | None,
    ) -> None:
        """Put obstacles on the tracks of new episodes: given, or drawn away from the starts.

        ``starts``, shape (len(rows), cars), are the arc lengths of the cars at the start, m.
        ``given`` are the boxes of each episode, each of shape (K, 7).
        """
        if given is None and self.obstacles is None and not self._blocked:
            return
        for i, row in enumerate(rows):
            self._stand(row, NO_BOXES)  # remove the old obstacles
            if given is not None:
                self._stand(row, given[i])
            elif self.obstacles is not None:
                self._stand(row, self.obstacles.draw(self.track(row), starts[i], generators[i]))

    def _stand(self, row: int, boxes: NDArray[np.float64]) -> None:
        """Put these obstacles, and no others, on an episode's track."""
        self._tracks[row], self.boxes[row] = None, NO_BOXES
        if len(boxes):
            self._blocked = True
            self._tracks[row], self.boxes[row] = (
                _with_obstacles(self.track(row), boxes),
                np.array(boxes),
            )

    def draw(self, rows: NDArray[np.int64], generators: Sequence[np.random.Generator]) -> None:
        """Draw the random values of new episodes, each from its own generator."""
        self.circuits.draw(rows, generators)
        if not self.drawn:
            return
        for row, generator in zip(rows, generators, strict=True):
            values = self.ranges.draw(generator, len(self.cars))
            cars = list(map(with_values, self.cars, values))
            self.vehicles[row] = [car.as_row() for car in cars]
            for name, own in self.drawn.items():
                own[row] = (
                    [as_number(name, getattr(car, name)) for car in cars]
                    if own.ndim == 2
                    else as_number(name, values[0][name])
                )

    def conditions(self, rows: NDArray[np.int64]) -> RaceConditions:
        """Return the cars and tracks of some episodes, for a batch of these episodes alone."""
        vehicles = np.ascontiguousarray(self.vehicles[rows]) if self.drawn else None
        # None if nothing differs from the setup: the kernels then drive all races in one call.
        tracks = None
        if self._blocked and any(self._tracks[row] is not None for row in rows):
            tracks = tuple(self.track(row) for row in rows)
        return (
            AS_THE_SETUP
            if vehicles is None and tracks is None
            else RaceConditions(vehicles, tracks)
        )

    def groups(self, rows: NDArray[np.int64]) -> list[tuple[int, NDArray[np.int64]]]:
        """Return the track numbers of some episodes, each with its indices in ``rows``."""
        if not self.circuits.several:
            return [(0, np.arange(len(rows)))]
        numbers = self.circuits.number[rows]
        return [(int(number), np.flatnonzero(numbers == number)) for number in np.unique(numbers)]

    def infos(self, players: int) -> dict[str, NDArray[Any]]:
        """Return the values drawn for each episode, for each of its players, as numbers.

        They have the shape (episodes * players,), or (episodes * players, cars) if drawn per car.
        """
        infos = {"track": self.circuits.number} if self.circuits.several else {}
        if self.obstacles is not None:
            infos["obstacles"] = np.array([len(boxes) for boxes in self.boxes])
        return {
            name: own_first(values, players) if values.ndim == 2 else np.repeat(values, players)
            for name, values in {**infos, **self.drawn}.items()
        }

    def info(self, episode: int, car: int) -> dict[str, Any]:
        """Return the values drawn for one episode, for the player of a car."""
        infos: dict[str, Any] = {}
        if self.circuits.several:
            infos["track"] = self.circuits.number.item(episode)
        if self.obstacles is not None:
            infos["obstacles"] = len(self.boxes[episode])
        for name, values in self.drawn.items():
            own = values[episode : episode + 1]
            infos[name] = own_first(own, car + 1)[car] if own.ndim == 2 else own.item()
        return infos

    def get_state(self) -> tuple[Any, ...]:
        """Return copies of all variables."""
        drawn = {name: one.copy() for name, one in self.drawn.items()}
        return self.circuits.get_state(), self.vehicles.copy(), drawn, list(self.boxes)

    def check_state(self, state: tuple[Any, ...]) -> list[Track]:
        """Refuse a state that `get_state` can't have returned.

        Return the track of each episode, with its obstacles.
        """
        check_part(
            "the state's randomization", state, (*self.get_state()[:3], [FREE] * self.episodes)
        )
        circuits, vehicles, _, boxes = state
        steering, speed = vehicles[..., STEER_DELAY], vehicles[..., SPEED_DELAY]
        check_within("the state's steering delays", steering, 0, self._queue)
        check_within("the state's speed delays", speed, 0, self._queue)
        check_within("the state's delays of both commands", steering + speed, 0, self._queue)
        late = max(car.opponent_delay for car in (*self.cars, self.ranges.max_delays))
        seen_late = vehicles[..., OPPONENT_DELAY]
        check_within("the state's opponent delays", seen_late, 0, round(late / COMMAND_PERIOD))
        self._check_cars(vehicles)
        self.circuits.check_state(circuits)
        tracks = [self.circuits.track(int(number)) for number in circuits[0]]
        for row, own in enumerate(boxes):
            check_part(
                f"the state's obstacles of episode {row}",
                own,
                np.empty((len(own) if np.ndim(own) else 0, len(BOX) + len(MOTION))),
            )
        return [
            _with_obstacles(track, own) if len(own) else track
            for track, own in zip(tracks, boxes, strict=True)
        ]

    def _check_cars(self, vehicles: NDArray[np.float64]) -> None:
        """Refuse cars with another value of a parameter that is not drawn."""
        drawn = {*self.drawn, *(["inertia"] if "m" in self.drawn else [])}
        for column, name in enumerate(PARAMETERS):  # in the order of a row
            found = vehicles[..., column]
            own = np.array([car.as_row()[column] for car in self.cars])
            if name not in drawn and (found != own).any():
                raise InputError(
                    f"the state's cars have {name} {found[found != own][0]:g}, this environment's"
                    f" {own[0]:g}; use the get_state() of an environment with equal arguments"
                )

    def set_state(self, state: tuple[Any, ...], tracks: Sequence[Track]) -> None:
        """Continue from a state of `get_state`, on the tracks returned by `check_state`."""
        circuits, vehicles, drawn, boxes = state
        self.circuits.set_state(circuits)
        self.vehicles[:] = vehicles
        for name, values in drawn.items():
            self.drawn[name][:] = values
        self.boxes = [np.array(own) for own in boxes]
        self._tracks = [
            track if len(own) else None for track, own in zip(tracks, boxes, strict=True)
        ]
        self._blocked |= any(map(len, boxes))
