"""Opponents of an environment: competitors by name or as objects; of several, one is drawn for each episode."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import check_number
from pcs_racing.base.errors import InputError
from pcs_racing.envs.drive_options import DriveOptions
from pcs_racing.envs.models import model_policy, policy_of
from pcs_racing.game.competitor import Competitor, check_competitor, competitor_name, driver_policies, is_model
from pcs_racing.game.competitor_names import make_competitor
from pcs_racing.game.rules import RaceGame
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.planners.registry import parse_policy, planner_names


@dataclass(frozen=True, eq=False)
class Opponent:
    """One of the opponents that an episode may have."""

    name: str
    weight: float  #: How often it is drawn, in relation to the others.
    competitor: Competitor
    #: Of a driver, of which one is drawn for each episode; none where the opponent makes moves.
    policies: tuple[Policy, ...]

    @property
    def planner(self) -> Planner | None:
        """Planner of a driver; None where the opponent moves between the policies of the archive."""
        return self.policies[0].planner if self.policies else None

    def draw_policy(self, generator: np.random.Generator) -> Policy | None:
        """Draw the policy that a driver keeps to in an episode; None where the opponent makes moves."""
        if not self.policies:
            return None
        return self.policies[0 if len(self.policies) == 1 else int(generator.integers(len(self.policies)))]


def parse_opponents(given: Any, game: RaceGame) -> list[Opponent]:
    """Read the argument ``opponent`` of an environment: a competitor, or a list of them or of (weight, competitor).

    See :func:`pcs_racing.game.competitor_names.make_competitor` for names and :mod:`pcs_racing.game.competitor` for
    objects.
    """
    if not isinstance(given, list | tuple):
        return [_opponent(given, 1.0, game)]
    if not given:
        raise InputError("opponent is an empty list; give at least one opponent")
    opponents = []
    for i, entry in enumerate(given):
        if isinstance(entry, list | tuple) and len(entry) != 2:
            raise InputError(f"opponent {i} of the mixture is {entry!r}; it must be an opponent or (weight, opponent)")
        weight, competitor = entry if isinstance(entry, list | tuple) else (1.0, entry)
        check_number(f"the weight of opponent {i}", weight, above=0.0)
        opponents.append(_opponent(competitor, float(weight), game))
    return opponents


def _opponent(given: Any, weight: float, game: RaceGame) -> Opponent:
    competitor = make_competitor(given, game) if isinstance(given, str) else given
    check_competitor(game, competitor)
    name = given.strip() if isinstance(given, str) else competitor_name(competitor)
    return Opponent(name, weight, competitor, driver_policies(competitor))


def draw_opponent(edges: NDArray[np.float64], generator: np.random.Generator) -> int:
    """Draw the index of an opponent, given the cumulated shares of all of them."""
    return min(int(np.searchsorted(edges, generator.random(), "right")), len(edges) - 1)


def drive_opponents(given: Any, make_game: Callable[[], RaceGame], options: DriveOptions, cars: int) -> list[Opponent]:
    """Read the argument ``opponent`` of Drive; the game is made only where an opponent is no policy.

    A model sees what ``options`` say in races of so many cars, unless it brings its own arguments.
    """
    entries = given if isinstance(given, list | tuple) else [given]
    # Policies need no game, which an archive would be loaded for.
    policies = [_as_policy(one, options, cars) for one in entries]
    if policies and all(isinstance(policy, Policy) for policy in policies):
        return [Opponent(policy.name, 1.0, policy, (policy,)) for policy in policies]
    return parse_opponents(policies if isinstance(given, list | tuple) else policies[0], make_game())


def _as_policy(given: Any, options: DriveOptions, cars: int) -> Any:
    """The policy of a text or of a model; anything else as it is."""
    if isinstance(given, tuple) and len(given) == 2:
        return given[0], _as_policy(given[1], options, cars)
    if is_model(given) and not isinstance(given, str | Path):
        own = callable(getattr(given, "get_env", None)) and given.get_env() is not None
        return model_policy(given) if own else policy_of(given, competitor_name(given), options, cars)
    named = isinstance(given, str) and given.partition(":")[0].strip() in planner_names()
    return parse_policy(given) if named else given


def shared_planner(opponents: list[Opponent], game: RaceGame | None) -> Planner:
    """Planner that drives the opponents' car: the archive's, or another one that all of them share.

    The game is needed where an opponent moves between the policies of its archive.
    """
    planners = [opponent.planner or game.archive.family() for opponent in opponents]  # type: ignore[union-attr]
    if not planners:
        return game.archive.family()  # type: ignore[union-attr]
    # The kernel is handed one planner for each car; a mixture only changes its parameters.
    for opponent, planner in zip(opponents, planners, strict=True):
        if planner is not planners[0]:
            raise InputError(
                f"opponents {opponents[0].name!r} and {opponent.name!r} drive with planners {planners[0].name!r} and "
                f"{planner.name!r}; the opponents of one environment must share a planner"
            )
    return planners[0]
