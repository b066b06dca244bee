"""Start of a batch of games: checks of arguments, and random numbers from each game's own key."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError, as_array, check_whole, check_whole_array
from pcs_racing.base.seeds import race_seeds
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.planners.registry import get_planner

DRAW = -1
"""Policy index that draws a policy."""


def game_keys(seeds: ArrayLike | None, games: int | None, seed: int) -> NDArray[np.uint64]:
    """Return the key of each game: the given seeds, or keys derived from one seed."""
    if seeds is None:
        return race_seeds(
            check_whole("seed", seed), 1 if games is None else check_whole("games", games)
        )
    if games is not None:
        raise InputError(
            f"games is {games!r}, but there are seeds, one for each game; give one of the two"
        )
    keys = np.atleast_1d(as_array(seeds))
    if (
        keys.ndim != 1
        or keys.dtype.kind not in "iu"
        or (keys.dtype.kind == "i" and (keys < 0).any())
    ):
        raise InputError(
            f"seeds are {seeds!r}; they must be whole numbers from 0, one for each game"
        )
    return keys.astype(np.uint64)


def check_policies(
    archive: PolicyArchive, policies: ArrayLike | None, games: int
) -> NDArray[np.int64]:
    """Return the first policy of each car, shape (games, 2); :data:`DRAW` if it will be drawn."""
    if policies is None:
        return np.full((games, 2), DRAW, np.int64)
    given = check_whole_array("policies", policies, (2,), (games, 2))
    indices = np.array(np.broadcast_to(given, (games, 2)))
    wrong = (indices < DRAW) | (indices >= len(archive))
    if wrong.any():
        game, car = (int(i) for i in np.argwhere(wrong)[0])
        raise InputError(
            f"game {game}, car {car}: policy {indices[game, car]} is not in archive"
            f" {archive.name!r}; it must lie in 0 to {len(archive) - 1}, or be -1 to be drawn"
        )
    return indices


def planner_parameters(
    archive: PolicyArchive,
    planner: Planner,
    car: int,
    drivers: Policy | Sequence[Policy | None] | None,
    games: int,
    size: int,
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Return a mask of policies from outside the archive, shape (games,), and their parameters.

    The parameters have shape (games, size). ``drivers`` are policies of the car's planner, one for
    all games or one for each; None is a policy of the archive.
    """
    role = ("ego", "opponent")[car]
    given = [drivers] * games if drivers is None or isinstance(drivers, Policy) else list(drivers)
    if len(given) != games:
        raise InputError(
            f"there are {games} games but {len(given)} {role}s; give one {role} for each game"
        )
    theta = np.zeros((games, size))
    in_archive = planner is get_planner(archive.planner)
    for i, driver in enumerate(given):
        if driver is None and not in_archive:
            raise InputError(
                f"game {i}: car {car} is driven by planner {planner.name!r}, which the archive"
                f" holds no policy of; give {role}s"
            )
        if driver is not None and (not isinstance(driver, Policy) or driver.planner is not planner):
            found = (
                f"planner {driver.planner.name!r}" if isinstance(driver, Policy) else repr(driver)
            )
            raise InputError(
                f"game {i}: the {role} is of {found}; this game's car {car} takes policies of"
                f" planner {planner.name!r} (make the game with {role}_planner=...)"
            )
        if driver is not None:
            theta[i, : len(driver.parameters)] = driver.parameters
    return np.array([driver is not None for driver in given], np.bool_).reshape(games), theta
