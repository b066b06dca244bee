"""The agent "remember": before each race of a match it chooses the best reply to opponents that
behave like this one.

Against a known opponent the best reply is a look-up in a payoff matrix. What was seen in the
earlier races tells which opponent of a pool it may be: each has a likelihood, normal in the
distance between what was seen and what it does on average, and the reply is the best one against
all of them by their likelihood (Bayes' rule, all opponents equally probable at first). Nothing is
learned from the races of the match but this.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import check_choice
from pcs_racing.base.errors import InputError
from pcs_racing.game.observation import AFTER_AXES, decode_match
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.blind import walk_to
from pcs_racing_agents.agents.game_spec import GameSpec
from pcs_racing_agents.base.fingerprint import fingerprint
from studies.matches.behaviours import Behaviours, features, load_behaviours

Floats = NDArray[np.float64]

REPLIES = ("likely", "nearest")


@dataclass(frozen=True, eq=False)
class RememberedReply:
    """The choice of a policy from what was seen in the earlier races of a match."""

    table: Behaviours
    spec: GameSpec  #: Its archive tells which policy was driven.
    #: "likely" or "nearest": To all opponents by their likelihood, or to the nearest one.
    reply: str = "likely"

    def __call__(self, observation: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the policies for observations of B matches, shape (B,)."""
        archive = self.spec.archive
        axes = len(archive.characteristics)
        memory = decode_match(observation, _seen_races(observation.shape[1], axes), axes)
        own = archive.nearest(memory.own)
        distance = self.table.distances(own, features(memory), memory.driven > 0.0)
        weight = np.exp(-0.5 * (distance - distance.min(axis=1, keepdims=True)))
        if self.reply == "nearest":
            # Before anything was seen all are equally near.
            weight = (weight == 1.0).astype(np.float64)
        return np.asarray((weight @ self.table.scores.T).argmax(axis=1), np.int64)

    @property
    def content_hash(self) -> str:
        """SHA-256 of all that its choices depend on."""
        return fingerprint(self.reply, self.table.content_hash, self.spec.archive.content_hash)


@dataclass(frozen=True, eq=False)
class MatchAgent(Agent):
    """An agent that also chooses the policy of each race of a match; its moves are for games of
    their own.
    """

    #: A function from what was observed of matches to policies.
    choice: RememberedReply | None = None

    def choose(self, observation: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the policies for the next races, shape (B,); see
        :class:`pcs_racing.game.competitor.Chooser`.
        """
        if self.choice is None:
            raise InputError(f"agent {self.name!r} has no choice of policies")
        return self.choice(np.asarray(observation, np.float32))

    @property
    def content_hash(self) -> str:
        """SHA-256 of all that its moves and choices depend on, without its name."""
        return fingerprint(super().content_hash, self.choice)


def remember(
    spec: GameSpec,
    *,
    name: str = "remember",
    seed: int = 0,
    table: str | Path | Behaviours,
    reply: str = "likely",
) -> MatchAgent:
    """Choose, before each race of a match, the best reply to the opponents that behave like the one
    that was seen.

    Parameters
    ----------
    seed : int
        Not used.
    table : Behaviours or path
        What each policy of the archive sees of a pool of opponents and wins against them; `python
        -m studies match --out DIR` writes it to ``DIR/behaviours``.
    reply : str
        "likely": the best policy against all opponents of the pool, each by the likelihood of what
        was seen; "nearest": the best policy against the one whose behaviour is nearest.
    """
    check_choice("reply", reply, REPLIES)
    known = load_behaviours(table)
    known.check_fits(spec, f"the table of behaviours of agent {name!r}")
    strategy = walk_to(spec, known.best_fixed)
    facts = {"pool": f"{len(known.opponents)} opponents", "trained on": _trained(known)}
    return MatchAgent(name, strategy, spec, seed, facts, choice=RememberedReply(known, spec, reply))


def _trained(table: Behaviours) -> str:
    return ", ".join(f"{key} {value}" for key, value in table.training.items()) or "not said"


def _seen_races(size: int, axes: int) -> int:
    """Number of races of a match whose players observe ``size`` numbers between races."""
    # The share of races left and the place on the grid follow the races.
    races, rest = divmod(size - 2, 2 * axes + AFTER_AXES)
    if rest or races < 1:
        raise InputError(
            f"an observation has {size} numbers; with {axes} axes it has {2 * axes + AFTER_AXES}"
            " for each race and 2 more"
        )
    return races
