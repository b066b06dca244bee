"""Common parts of the batches of episodes below all environments.

:class:`pcs_racing.envs.drive_batch.DriveBatch` and
:class:`pcs_racing.envs.game_batch.GameBatch` have the same methods, and an environment takes
either. A batch advances E episodes at once, each with one or more players. An environment is one
player's view of an episode: environment ``i`` belongs to player ``i % players`` of episode
``i // players``. Each episode draws from its own generator, so a batch of any size gives the same
numbers. :class:`pcs_racing.envs.single.SingleEnv` and
:class:`pcs_racing.envs.vector.BatchVectorEnv`, not the batch, handle the end of an episode.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, as_array, check_whole
from pcs_racing.car.vehicle import BETA, DELTA, F1TENTH, PSI, PSI_DOT, V
from pcs_racing.race.config import Rules
from pcs_racing.race.races import RaceSetup
from pcs_racing.race.start_grid import Starts, places_of_grid, settle
from pcs_racing.race.state import CAR_CRASH, LAPS, RaceState, empty_state
from pcs_racing.track.frenet import X, Y
from pcs_racing.track.moving import BOX, MOTION

Rows = NDArray[np.int64]
"""Indices of episodes, or a number for each episode."""

Generators = Sequence[np.random.Generator]
"""Random generators, one for each episode."""

MAX_EPISODES = 100_000

MAX_STEPS = 2**62

MAX_RATE = 1e4  # max speed, yaw rate and angles of a car in a state

FREE: Any = object()
"""Part of a state's template that matches any value."""


@dataclass(frozen=True, eq=False)
class Step:
    """Step of all episodes of a batch, as the input of a reward.

    The states are copies: a :class:`pcs_racing.race.state.RaceState` in Drive, a
    :class:`pcs_racing.game.state.GameState` in Duel. The first axis of their arrays counts the
    episodes; a scalar environment has one.
    """

    before: Any  #: State before the step.
    #: shape (episodes, players), moves; in Drive (episodes, players, 2), shares of the limits of
    #: steering angle and speed, clipped to [-1, 1] as in the race.
    actions: NDArray[Any]
    after: Any  #: State after the step.
    reward: NDArray[np.float64]  #: shape (episodes, players): Reward of the environment itself.


Reward = Callable[[Step], NDArray[np.float64]]
"""Function of a step that returns the reward of each player, shape (episodes, players)."""


def check_reward(
    values: Any, shape: tuple[int, ...], running: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return own rewards as an array (environments,); they must be finite in running episodes."""
    given = as_array(values)
    if given.shape != shape or given.dtype.kind not in "bif":
        raise InputError(
            f"the reward has shape {given.shape} and type {given.dtype}; it must be numbers of"
            f" shape {shape}: episodes and players"
        )
    wrong = np.flatnonzero(running & ~np.isfinite(given).all(axis=1))
    if len(wrong):
        raise InputError(
            f"the reward of episode {wrong[0]} is {given[wrong[0]].tolist()}; it must be finite"
        )
    return given.astype(np.float64).reshape(-1)


class BatchStep(NamedTuple):
    """Results of a step of n environments, in fresh arrays."""

    observations: NDArray[np.float32]  #: shape (n, D)
    rewards: NDArray[np.float64]  #: shape (n,)
    terminated: NDArray[np.bool_]  #: shape (n,)
    truncated: NDArray[np.bool_]  #: shape (n,)


def check_batch_size(episodes: int, threads: int | None) -> None:
    """Check the numbers of environments and threads of a batch."""
    check_whole("num_envs", episodes, 1, MAX_EPISODES)
    if threads is not None:
        check_whole("threads", threads, 1)


def read_numbers(
    options: Mapping[str, Any], name: str, shapes: Sequence[tuple[int | None, ...]], meaning: str
) -> Any:
    """Return an option as finite numbers of one of the shapes, or None if it is not given.

    None in a shape matches any size.
    """
    if options.get(name) is None:
        return None
    try:
        values = np.asarray(options[name], np.float64)
    except (TypeError, ValueError):
        values = np.full((), np.nan)
    fits = any(
        len(shape) == values.ndim
        and all(want in (None, size) for want, size in zip(shape, values.shape, strict=True))
        for shape in shapes
    )
    if not fits or not np.isfinite(values).all():
        raise InputError(
            f"reset option {name!r} is {options[name]!r:.80}; it must be {meaning}, finite numbers"
        )
    return values


def start_option(options: Mapping[str, Any], episodes: int, cars: int = 2) -> Starts | None:
    """Read the option "start", for all episodes or for each.

    It holds the arc length of the start line (m) and the place of car 0.
    """
    places = places_of_grid(cars)
    sides = "side 0 or 1" if places == 2 else f"place 0 to {places - 1}"
    meaning = f"(arc length in m, {sides}), for all episodes or for each of the {episodes}"
    values = read_numbers(options, "start", ((2,), (episodes, 2)), meaning)
    if values is None:
        return None
    s, side = np.broadcast_to(values, (episodes, 2)).T
    if not np.isin(side, np.arange(places)).all():
        raise InputError(f"reset option 'start' is {options['start']!r:.80}; it must be {meaning}")
    return Starts(s.copy(), side.astype(np.int64))


def poses_option(
    options: Mapping[str, Any], episodes: int, cars: int = 2
) -> NDArray[np.float64] | None:
    """Read the option "poses": x, y (m), heading (rad) and optionally speed (m/s) of all cars.

    The result has the shape (B, N, 4). In a single-car race a second pose is ignored.
    """
    rows = (1, 2) if cars == 1 else (cars,)
    shapes = [(*first, row, size) for first in ((), (episodes,)) for row in rows for size in (3, 4)]
    whose, row = ("both cars", 2) if cars == 2 else ("all cars", cars)
    meaning = (
        f"x, y, heading and, if not 0, speed of {whose}, shape ({row}, 3), ({row}, 4) or with"
        f" {episodes} rows of these"
    )
    values = read_numbers(options, "poses", shapes, meaning)
    if values is None:
        return None
    poses = np.zeros((episodes, cars, 4))
    poses[..., : values.shape[-1]] = values[..., :cars, :]
    if not ((poses[..., 3] >= 0.0) & (poses[..., 3] <= F1TENTH.v_max)).all():
        raise InputError(
            f"a speed in the reset option 'poses' is not from 0 to {F1TENTH.v_max:g} m/s"
        )
    return poses


def obstacles_option(
    options: Mapping[str, Any], episodes: int
) -> Sequence[NDArray[np.float64]] | None:
    """Read the option "obstacles" of a reset, for all episodes or for each.

    It holds boxes (x, y, heading, length, width), with speed and sway if they move. A width of 0
    means a circle (:data:`pcs_racing.track.moving.BOX`, ``MOTION``).
    """
    given = options.get("obstacles")
    if given is None:
        return None
    from pcs_racing.track.obstacles import obstacle_rows

    if isinstance(given, list | tuple) and len(given) == 0:  # no second axis
        return [obstacle_rows([])] * episodes
    few, all_ = len(BOX), len(BOX) + len(MOTION)
    shapes = [(*lead, None, n) for n in (few, all_) for lead in ((), (episodes,))]
    meaning = (
        f"boxes ({', '.join(BOX)}), with {' and '.join(MOTION)} if they move, of shape (K, {few})"
        f" or ({episodes}, K, {few}), {all_} with motion"
    )
    boxes = read_numbers(options, "obstacles", shapes, meaning)
    return [obstacle_rows(one) for one in np.broadcast_to(boxes, (episodes, *boxes.shape[-2:]))]


def place_poses(setup: RaceSetup, poses: NDArray[np.float64]) -> RaceState:
    """Return races with the cars at given poses, shape (B, N, 4).

    Progress is counted from the front car.
    """
    state = empty_state(len(poses), setup.memory_size, len(setup.vehicles), setup.rules.laps)
    state.cars[:, :, X], state.cars[:, :, Y] = poses[..., 0], poses[..., 1]
    state.cars[:, :, PSI] = np.mod(poses[..., 2], 2.0 * np.pi)
    state.cars[:, :, V] = poses[..., 3]
    settle(setup.track, setup.vehicles, state)
    wrong = np.flatnonzero(state.crashed)
    if len(wrong):
        where, other = (
            poses[wrong[0], :, :3].tolist(),
            "the other car" if state.number == 2 else "another car",
        )
        raise InputError(
            f"episode {wrong[0]}: at the poses {where} a car overlaps a wall or {other}"
        )
    length = setup.track.length
    behind = (
        np.mod(state.frenet[:, :1, 0] - state.frenet[..., 0] + 0.5 * length, length) - 0.5 * length
    )
    state.progress[:] = behind.min(axis=1, keepdims=True) - behind
    return state


# Checks of a state to restore: all of them run before anything is written.


def check_part(name: str, given: Any, like: Any) -> None:
    """Refuse a part of a state with other types or shapes than ``like``, or numbers not finite."""
    if like is FREE:
        return
    found, wanted = type(given).__name__, type(like).__name__
    fits = type(given) is type(like)
    if isinstance(like, np.ndarray):
        wanted = f"finite {like.dtype} of shape {like.shape}"
        found = f"{given.dtype} of shape {given.shape}" if fits else found
        fits = fits and (given.dtype, given.shape) == (like.dtype, like.shape)
        fits = fits and (like.dtype.kind != "f" or bool(np.isfinite(given).all()))
    elif isinstance(like, dict | list | tuple) and fits:
        keys = [
            list(one) if isinstance(one, dict) else list(range(len(one))) for one in (given, like)
        ]
        wanted, found, fits = (
            f"{wanted} with {keys[1]!r:.80}",
            f"{found} with {keys[0]!r:.80}",
            keys[0] == keys[1],
        )
        for key in keys[1] if fits else ():
            part = like._fields[key] if hasattr(like, "_fields") else key
            check_part(f"{name}.{part}", given[key], like[key])
    if not fits:
        raise InputError(
            f"{name} is {found}; it must be {wanted}: use a state of get_state from an environment"
            " of equal arguments"
        )


def check_within(name: str, values: NDArray[Any], low: float, high: ArrayLike) -> None:
    """Refuse numbers of a state outside a range, both ends included."""
    wrong = (values < low) | (values > high)
    if wrong.any():
        end = float(np.broadcast_to(high, values.shape)[wrong][0])
        raise InputError(f"{name} holds {values[wrong][0]}; it must be from {low:g} to {end:g}")


def check_races(name: str, races: RaceState, rules: Rules, lengths: NDArray[np.float64]) -> None:
    """Refuse races with a number out of its range; ``lengths`` are the track lengths, m."""
    for part, low, high in (
        ("tick", 0, rules.ticks),
        ("crash", 0, CAR_CRASH),
        ("contact", 0, CAR_CRASH),
        ("fault", 0, 127),
        ("leader", -1, races.number - 1),
        ("overtakes", 0, rules.ticks),
    ):
        check_within(f"{name}.{part}", getattr(races, part), low, high)
    check_within(f"{name}.laps", races.laps[..., LAPS], 0, rules.ticks)
    check_within(f"{name}.frenet", races.frenet[..., 0], 0.0, lengths[:, None])
    # A car that moves by more than the grid in a step would be looked up outside of it.
    for column in (DELTA, V, PSI_DOT, BETA):
        check_within(f"{name}.cars", races.cars[..., column], -MAX_RATE, MAX_RATE)


def generator_of(name: str, state: Any) -> np.random.Generator:
    """Return a new generator with a given state."""
    generator = np.random.default_rng()
    try:
        generator.bit_generator.state = state
        # NumPy truncates numbers that do not fit in a field.
        if generator.bit_generator.state != dict(state):
            raise ValueError(f"{state!r:.200}")
    except (TypeError, ValueError, KeyError, OverflowError, AttributeError) as error:
        raise InputError(f"{name}, a random generator, can't be restored: {error}") from None
    return generator


# Weights of the opponents in a draw.

WEIGHTS = 1e-12, 1e12
"""Min and max weight of an opponent in a draw."""


def weights_of(opponents: Sequence[Any]) -> NDArray[np.float64]:
    """Return the weights of the opponents, shape (max(1, n),)."""
    return np.array([opponent.weight for opponent in opponents] or [1.0])


def check_weights(given: Any, like: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return new weights of the opponents, as many as in ``like``."""
    weights = as_array(given)
    low, high = WEIGHTS
    fits = weights.shape == like.shape and weights.dtype.kind in "iuf"
    if not fits or not ((weights >= low) & (weights <= high)).all():
        raise InputError(
            f"the weights of the opponents are {given!r:.80}; they must be {len(like)} numbers"
            f" from {low:g} to {high:g}, one for each opponent"
        )
    return weights.astype(np.float64)


def draw_opponent(weights: NDArray[np.float64], generator: np.random.Generator) -> int:
    """Draw the index of an opponent, given the weights of all opponents."""
    edges = np.cumsum(weights) / weights.sum()
    return min(int(np.searchsorted(edges, generator.random(), "right")), len(edges) - 1)
