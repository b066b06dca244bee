from dataclasses import dataclass

import numpy as np
from refusal import refused
from zoo_games import untrained

from pcs_racing.base.errors import UnknownNameError
from pcs_racing.game import players
from pcs_racing_agents.agents import Agent, make_game_spec
from pcs_racing_agents.agents.from_network import from_network
from pcs_racing_agents.agents.mixture import make_mixture
from pcs_racing_agents.agents.zoo import build
from pcs_racing_agents.networks import NetworkSet, save_network_set


@dataclass(frozen=True)
class Chances:
    """A strategy with the probabilities of a constant player."""

    player: players.ConstantPlayer

    def __call__(self, observation):
        return self.player.probabilities(observation)


def constant(player, spec):
    return Agent(player.name, Chances(player), spec)


def always(spec, move):
    return constant(players.always(spec, move), spec)


def never_switch(spec):
    return constant(players.never_switch(spec), spec)


def random_moves(spec):
    return constant(players.random_moves(spec), spec)


def on_the_way(
    chances: np.ndarray, table: np.ndarray, here: np.ndarray, there: np.ndarray
) -> np.ndarray:
    """How likely a strategy goes from one policy to another, whichever of the moves that do it
    makes.
    """
    return (chances * (table[here] == there[:, None])).sum(axis=1)


def test_drawing_on_the_way_is_drawing_before_the_game(game, spec, network):
    """Kuhn's theorem: every course of a game is as likely under the mixture as if a member had been
    drawn for it.
    """
    members = [
        random_moves(spec),
        from_network(
            spec, name="regrets", kind="regret", decision="regret-matching", network=network
        ),
        from_network(spec, name="logits", kind="regret", decision="softmax", network=network),
    ]
    weights = np.array([0.2, 0.5, 0.3])
    mixture = Agent("mixture", make_mixture(members, weights), spec)
    state = game.reset(games=30, seed=4)
    rng = np.random.default_rng(1)
    behaviour, drawn = np.ones(30), np.ones((3, 30))
    differed = False
    while not game.done(state).all():
        running = ~game.done(state)
        seen = game.observation(state)[:, 0]
        after = game.step(state, rng.integers(0, 4, (30, 2)))
        way = (spec.table, state.policy[:, 0], after.policy[:, 0])
        steps = [on_the_way(one.probabilities(seen), *way) for one in (mixture, *members)]
        differed |= bool((np.abs(steps[0] - weights @ np.array(steps[1:])) > 0.01).any())
        behaviour *= np.where(running, steps[0], 1.0)
        drawn *= np.where(running, steps[1:], 1.0)
        state = after
    np.testing.assert_allclose(behaviour, weights @ drawn, rtol=1e-9, atol=1e-15)
    assert differed, "the members must have become unequally likely, or this test says nothing"


def test_a_member_that_would_not_have_come_here_is_out(spec, game):
    stays, goes = never_switch(spec), always(spec, "aggressiveness +")
    mixture = Agent(
        "mixture", make_mixture([stays, random_moves(spec), goes], [2.0, 0.0, 2.0]), spec
    )
    assert mixture.strategy.members == (stays, goes)
    state = game.reset(games=4, seed=1, policies=(0, 3))
    np.testing.assert_allclose(
        mixture.probabilities(game.observation(state)[:, 0]), [[0.5, 0, 0, 0, 0.5]] * 4
    )
    moved = game.step(state, np.tile([0, 4], (4, 1)))
    assert (moved.policy[:, 0] != 0).all()
    np.testing.assert_array_equal(
        mixture.probabilities(game.observation(moved)[:, 0]), [[1, 0, 0, 0, 0]] * 4
    )
    stayed = game.step(state, np.full((4, 2), 4))
    np.testing.assert_array_equal(
        mixture.probabilities(game.observation(stayed)[:, 0]), [[0, 0, 0, 0, 1]] * 4
    )


def test_a_set_of_networks_is_played_as_the_mixture_of_its_members(spec, seen, tmp_path):
    networks = tuple(untrained(spec, "advantage", seed) for seed in (1, 2, 3))
    known = NetworkSet(
        "three", networks, np.array([1.0, 2.0, 1.0]), "regret-matching", {"rounds": 3}
    )
    folder = save_network_set(known, tmp_path / "three")
    agent = build("self-play", spec, networks=str(folder))
    rule = {"kind": "any", "decision": "regret-matching"}
    members = [
        from_network(spec, name=network.name, network=network, **rule) for network in networks
    ]
    by_hand = make_mixture(members, [0.25, 0.5, 0.25])
    for rows in seen[:-1]:
        np.testing.assert_array_equal(agent.probabilities(rows), by_hand(rows))
    facts = {key: agent.facts[key] for key in ("networks", "weights", "decision", "trained on")}
    assert list(facts.values()) == [
        "three: 3, preset paper",
        "0.25, 0.5, 0.25",
        "regret-matching",
        "rounds 3",
    ]
    assert (
        build("psro", make_game_spec("contest", "contest"))
        .facts["networks"]
        .startswith("contest-contest-psro: ")
    )
    assert agent.content_hash == build("self-play", spec, networks=known).content_hash
    other = NetworkSet("three", networks[::-1], np.array([3.0, 2.0, 1.0]), "regret-matching")
    assert agent.content_hash != build("self-play", spec, networks=other).content_hash


def test_bad_mixtures_are_refused_and_without_networks_the_error_says_how_to_make_them(
    spec, archive
):
    stay = never_switch(spec)
    for weights in ([], [1.0, 2.0], [-1.0], [0.0], [np.nan]):
        refused("weights", make_mixture, [stay], weights)
    refused(
        "'never-switch' can't be a member of a mixture",
        make_mixture,
        [stay, "never-switch"],
        [1, 1],
    )
    other = never_switch(make_game_spec(archive, "contest"))
    refused("different archives or rules", make_mixture, [stay, other], [1, 1])
    for name in ["psro", "self-play"]:
        refused(
            f"'toy-paper-{name}'.*pcs-racing train {name}",
            build,
            name,
            spec,
            error=UnknownNameError,
        )
        refused("'nowhere'", build, name, spec, networks="nowhere", error=UnknownNameError)
