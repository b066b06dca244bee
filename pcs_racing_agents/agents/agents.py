"""How the agents of the zoo are made: one function for each, which takes the setting, its name, a seed and options."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing_agents.agents.agent import Agent
from pcs_racing_agents.agents.blind import Blend, Schedule, walk_to
from pcs_racing_agents.agents.fits import Fit, find_fit
from pcs_racing_agents.agents.mixture import make_mixture
from pcs_racing_agents.agents.network import FromNetwork, OverBlind, fitting_network, network_facts
from pcs_racing_agents.agents.setting import STAY, Setting
from pcs_racing_agents.networks.network import RegretNetwork

__all__ = [
    "adaptive",
    "always",
    "best_fixed",
    "best_schedule",
    "from_network",
    "never_switch",
    "psro",
    "random_moves",
    "restricted_response",
]

FitSource = str | Path | Fit | None
NetworkSource = str | RegretNetwork | None


def always(setting: Setting, move: str, *, name: str | None = None, seed: int = 0) -> Agent:
    """Make the same move again and again."""
    chances = np.eye(len(setting.moves))[setting.move(move)]
    return Agent(name or f"always-{''.join(move.split())}", Blend(chances), setting, seed)


def never_switch(setting: Setting, *, name: str = "never-switch", seed: int = 0) -> Agent:
    """Keep the policy of the start: the paper's non-GT agent."""
    return always(setting, STAY, name=name, seed=seed)


def random_moves(setting: Setting, *, name: str = "random-moves", seed: int = 0) -> Agent:
    """Draw each move, all that the rules offer with the same chance."""
    chances = np.zeros(len(setting.moves))
    chances[: setting.offered] = 1.0 / setting.offered
    return Agent(name, Blend(chances), setting, seed)


def best_schedule(
    setting: Setting,
    *,
    name: str = "best-schedule",
    seed: int = 0,
    moves: Sequence[str] | None = None,
    fit: FitSource = None,
) -> Agent:
    """Make the moves of a plan, one after the other, whatever happens.

    Parameters
    ----------
    setting : Setting
    name : str
    seed : int
    moves : sequence of str, optional
        The sequence: as many names of moves as a game has.
    fit : Fit or path, optional
        A sequence selected by :func:`pcs_racing_agents.tournament.fitting.fit_best_schedule`;
        the shipped one by default.
    """
    facts = {}
    if moves is None:
        found = find_fit("best-schedule", setting, fit)
        moves, facts = found.choice, _told(found)
    elif fit is not None:
        raise InputError(f"agent {name!r} got moves and a fit; give one of the two")
    if isinstance(moves, str) or len(moves) != setting.config.moves:
        raise InputError(f"agent {name!r} got the plan {moves!r}; a game has {setting.config.moves} moves")
    sequence = np.array([setting.move(move) for move in moves], np.int64)
    strategy = Schedule(sequence, len(setting.moves), len(setting.archive.characteristics))
    return Agent(name, strategy, setting, seed, {**facts, "plan": ", ".join(setting.moves[i] for i in sequence)})


def best_fixed(
    setting: Setting,
    *,
    name: str = "best-fixed",
    seed: int = 0,
    target: int | None = None,
    fit: FitSource = None,
) -> Agent:
    """Walk to one policy of the archive by a shortest path of moves, and keep it.

    Parameters
    ----------
    setting : Setting
    name : str
    seed : int
    target : int, optional
        The policy's index.
    fit : Fit or path, optional
        A target selected by :func:`pcs_racing_agents.tournament.fitting.fit_best_fixed`; the shipped one by default.
    """
    facts = {}
    if target is None:
        found = find_fit("best-fixed", setting, fit)
        target, facts = found.choice, _told(found)
    elif fit is not None:
        raise InputError(f"agent {name!r} got a target and a fit; give one of the two")
    strategy = walk_to(setting, target)
    point = ", ".join(
        f"{axis} {value:.2f}"
        for axis, value in zip(setting.archive.characteristics, setting.archive.normalised[target], strict=True)
    )
    return Agent(name, strategy, setting, seed, {**facts, "target": f"policy {target} ({point})"})


def from_network(
    setting: Setting,
    *,
    name: str,
    seed: int = 0,
    kind: str,
    decision: str = "argmax",
    network: NetworkSource = None,
) -> Agent:
    """Decide by what a network says that each move is worth.

    Parameters
    ----------
    setting : Setting
    name : str
    seed : int
    kind : str
        What the network was trained to approximate; names the shipped one (``ARCHIVE-RACE-KIND``).
    decision : {"argmax", "regret-matching", "sample", "softmax"}
        The rule: ``argmax``, ``regret-matching``, ``sample`` or ``softmax``.
    network : RegretNetwork, str or path, optional
        Another network: the name of a shipped one or its folder.
    """
    found = fitting_network(network, setting, kind, name)
    strategy = FromNetwork(found, decision, len(setting.moves))
    return Agent(name, strategy, setting, seed, {**network_facts(found), "decision": decision})


def adaptive(
    setting: Setting,
    *,
    name: str = "adaptive",
    seed: int = 0,
    kind: str = "gain",
    network: NetworkSource = None,
    blind: str | Agent = "best-fixed",
    margin: float | None = None,
) -> Agent:
    """Keep to the best strategy that never looks at the race, and leave it where a network promises clearly more.

    Parameters
    ----------
    setting : Setting
    name : str
    seed : int
    kind : str
        What the network was trained to approximate; names the shipped one.
    network : RegretNetwork, str or path, optional
        What each move is worth: another network, the name of a shipped one or its folder.
    blind : Agent or str
        The default strategy, with its own needs.
    margin : float, optional
        How much more a move must promise, in units of the network's target; by default what the network's training says
        (``margin``), else 0.
    """
    found = fitting_network(network, setting, kind, name)
    habit = _member(blind, setting, seed)
    if margin is None:
        margin = found.training.get("margin", 0.0)  # type: ignore[assignment]
    if isinstance(margin, bool) or not isinstance(margin, int | float) or not 0.0 <= margin < np.inf:
        raise InputError(f"the margin of agent {name!r} is {margin!r}; it must be a finite number from 0")
    facts = {**network_facts(found), "keeps to": habit.name, "margin": f"{margin:g}"}
    return Agent(name, OverBlind(found, habit, float(margin)), setting, seed, facts)


def restricted_response(
    setting: Setting,
    *,
    name: str = "restricted-response",
    seed: int = 0,
    exploit: str | Agent = "static-q",
    safe: str | Agent = "nash",
    share: float = 0.5,
) -> Agent:
    """Draw for each game whether to exploit or to play safe.

    Parameters
    ----------
    setting : Setting
    name : str
    seed : int
    exploit : Agent or str
        The agent that exploits.
    safe : Agent or str
        The agent of the other games.
    share : float
        The probability of exploiting, in [0, 1].
    """
    if isinstance(share, bool) or not isinstance(share, int | float) or not 0.0 <= share <= 1.0:
        raise InputError(f"the share of agent {name!r} is {share!r}; it must be a number from 0 to 1")
    members = [_member(member, setting, seed) for member in (exploit, safe)]
    facts = {"mixture": f"{share:g} {members[0].name}, {1.0 - share:g} {members[1].name}"}
    return Agent(name, make_mixture(members, [share, 1.0 - share]), setting, seed, facts)


def psro(
    setting: Setting,
    *,
    name: str = "psro",
    seed: int = 0,
    weights: Mapping[str, float] | None = None,
    members: Sequence[Agent] = (),
    fit: FitSource = None,
) -> Agent:
    """Draw an agent for each game, with the chances of an equilibrium of the game of choosing agents.

    Parameters
    ----------
    setting : Setting
    name : str
    seed : int
    weights : mapping of str to float, optional
        The probability of each agent, by name.
    members : sequence of Agent
        Agents given as objects instead of by name.
    fit : Fit or path, optional
        Weights computed by :func:`pcs_racing_agents.tournament.fitting.fit_psro`; the shipped ones by default.
    """
    facts = {}
    if weights is None:
        found = find_fit("psro", setting, fit)
        weights, facts = found.choice, _told(found)
    elif fit is not None:
        raise InputError(f"agent {name!r} got weights and a fit; give one of the two")
    own = {member.name: member for member in members}
    drawn = {key: value for key, value in weights.items() if value}
    agents = [own[key] if key in own else _member(key, setting, seed) for key in drawn]
    mixture = make_mixture(agents, list(drawn.values()))
    return Agent(name, mixture, setting, seed, {**facts, "mixture": _listed(mixture)})


def _listed(mixture: Any) -> str:
    pairs = zip(mixture.weights, mixture.members, strict=True)
    return ", ".join(f"{weight:.3g} {member.name}" for weight, member in pairs)


def _told(fit: Fit) -> dict[str, str]:
    """What reports say of a choice."""
    trained = ", ".join(f"{key} {value}" for key, value in fit.training.items())
    return {"trained on": trained or "not said"}


def _member(given: str | Agent, setting: Setting, seed: int) -> Agent:
    """Return an agent that another one is made of."""
    if isinstance(given, Agent):
        return given
    from pcs_racing_agents.agents.zoo import build  # the zoo makes agents of agents

    made = build(given, setting, seed=seed)
    if not isinstance(made, Agent):
        raise InputError(f"{given!r} makes no moves; only agents can be part of another one")
    return made
