"""What does looking at the race add? An adaptive strategy against the best one that never looks."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.errors import InputError
from pcs_racing_agents.tournament.statistics.comparison import Comparison, compare
from pcs_racing_agents.tournament.statistics.units import check_values

__all__ = ["AdaptivityGain", "adaptivity_gain"]


@dataclass(frozen=True)
class AdaptivityGain:
    """What looking at the race adds to the best strategy that never looks.

    Attributes
    ----------
    best_blind : str
        The blind arm with the highest mean score in training.
    training : dict of str to float
        Mean training score of every blind arm.
    gain : Comparison
        The adaptive arm (a) against that blind arm (b) on the test races.
    over_each : dict of str to Comparison
        The adaptive arm against every blind arm on the test races. The smallest of these differences is biased
        downwards: it compares with the arm that was luckiest in these very races.
    """

    best_blind: str
    training: dict[str, float]
    gain: Comparison
    over_each: dict[str, Comparison]


def adaptivity_gain(
    adaptive: ArrayLike,
    blind: Mapping[str, ArrayLike],
    ego: ArrayLike,
    opponent: ArrayLike,
    *,
    training: Mapping[str, ArrayLike],
    start: ArrayLike | None = None,
    same_pool: bool = False,
    level: float = 0.95,
) -> AdaptivityGain:
    """Return the gain of an adaptive strategy over the best blind one, the latter chosen on separate races.

    Choosing the best blind arm on the test races themselves would make it look better than it is, and the gain
    smaller; choosing the adaptive arm on them would make the gain larger. So both must be chosen on training races,
    which should start at other places than the test races. This function sees scores only, and refuses no more than the
    very same ones; which places the races of a study draw from is decided in :func:`pcs_racing.race.races.start_lines`.
    The interval holds for the blind arm that was chosen. With too few training races that is not the best one, and the
    gain is flattered; ``over_each`` shows whether another one does better.

    Parameters
    ----------
    adaptive : array_like, shape (U,)
        Test scores of the adaptive arm.
    blind : mapping of str to array_like, shape (U,)
        Test scores of every blind arm, in the same races.
    ego, opponent : array_like, shape (U,)
        Labels of the test races.
    training : mapping of str to array_like
        Training scores of the same blind arms; all arms in the same training races, in any number.
    start, same_pool, level
        As in :func:`compare`.

    Returns
    -------
    AdaptivityGain

    Raises
    ------
    InputError
        If there is no blind arm, the arms of training and test differ, the training races are the test races, or for
        any reason that :func:`compare` has.
    """
    if not blind:
        raise InputError("there are no blind arms; the gain is over the best of at least one")
    if set(blind) != set(training):
        odd = sorted(set(blind) ^ set(training))
        raise InputError(f"blind arm {odd[0]!r} is in only one of training and test; it must be in both")
    scores = {name: check_values(f"training[{name!r}]", training[name]) for name in blind}
    sizes = {len(values) for values in scores.values()}
    if len(sizes) > 1:
        raise InputError(f"the blind arms have {sorted(sizes)} training races; all must have raced the same ones")
    tested = {name: check_values(f"blind[{name!r}]", blind[name]) for name in blind}
    shared = any(np.shares_memory(scores[name], tested[name]) for name in blind)
    if shared or (len(blind) > 1 and all(np.array_equal(scores[name], tested[name]) for name in blind)):
        raise InputError("the training scores are the test scores; choose the blind arm on races of their own")
    means = {name: float(values.mean()) for name, values in scores.items()}
    best = max(means, key=lambda name: means[name])  # the first of equals
    over_each = {
        name: compare(adaptive, tested[name], ego, opponent, start=start, same_pool=same_pool, level=level)
        for name in blind
    }
    return AdaptivityGain(best, means, over_each[best], over_each)
