from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given, strategies as st
from refusal import refused

from pcs_racing.base.errors import UnknownNameError
from pcs_racing.game.make import make_game
from pcs_racing.game.players import never_switch
from pcs_racing_agents.agents.blind import (
    best_fixed,
    best_lead_plan,
    best_schedule,
    find_fit,
    load_fit,
    make_fit,
    path_moves,
    save_fit,
)
from pcs_racing_agents.agents.zoo import build


def test_a_schedule_follows_the_steps_and_never_switching_is_staying(spec, game, seen):
    plan = ["restraint +", "stay", "aggressiveness-", "restraint +"]
    agent = best_schedule(spec, moves=plan)
    state = game.reset(games=3, seed=5)
    for expected in (2, 4, 1, 2):
        moves = agent.act(game.observation(state)[:, 0])
        np.testing.assert_array_equal(moves, expected)
        state = game.step(state, np.full((3, 2), 4))
    assert (agent.act(game.observation(state)[:, 0]) == 2).all()  # after the last step, too
    assert agent.facts["plan"] == "restraint +, stay, aggressiveness -, restraint +"
    refused("has 4 moves", best_schedule, spec, moves=plan[:3])
    refused("and a fit", best_schedule, spec, moves=plan, fit="somewhere.yaml")
    chances = never_switch(spec).probabilities(seen[2])
    np.testing.assert_array_equal(chances, np.tile([0, 0, 0, 0, 1], (40, 1)))


@pytest.mark.parametrize("target", [0, 5, 11])
def test_a_walk_arrives_and_stays(spec, game, target):
    """Every policy of the archive, by the rules of the game itself."""
    agent = best_fixed(spec, target=target)
    table, place = spec.table, spec.archive.normalised
    policy = np.arange(len(spec.archive))
    for _ in range(20):
        seen = np.zeros((len(policy), 31), np.float32)
        seen[:, :2] = place[policy]
        seen[:, 5] = 1.0
        policy = table[policy, agent.act(seen)]
    reached = _reachable(table)
    for start, end in enumerate(policy):
        away = np.linalg.norm(place[reached[start]] - place[target], axis=1)
        assert np.linalg.norm(place[end] - place[target]) == pytest.approx(away.min())
    seen = np.zeros((1, 31), np.float32)
    seen[0, :2], seen[0, 5] = place[target], 1.0
    assert int(agent.act(seen)[0]) == 4  # stay


def test_a_lead_plan_looks_at_who_leads_and_at_nothing_else(spec, game, seen):
    """Every decision is a step of the walk to one of its two policies, by the lead of the last step
    that is over.
    """
    plan = best_lead_plan(spec, targets={"behind": 10, "ahead": 1})
    walks = [best_fixed(spec, target=target) for target in (10, 1)]
    for made, observation in enumerate(seen):
        leads = observation[:, 6 * made + 4] >= 0.0
        assert 0 < leads.sum() < len(leads)
        expected = np.where(leads, *(walk.act(observation) for walk in reversed(walks)))
        np.testing.assert_array_equal(plan.act(observation), expected)
        hidden = observation.copy()
        for step in range(made + 1):
            hidden[:, 6 * step + 2 : 6 * step + 4] = 0.5  # the opponent's coordinates
            hidden[:, 6 * step + 4] = np.sign(hidden[:, 6 * step + 4])
        np.testing.assert_array_equal(plan.act(hidden), expected)
    one, other = spec.archive.normalised[1]
    assert plan.facts["ahead"] == f"policy 1 (aggressiveness {one:.2f}, restraint {other:.2f})"
    assert best_fixed(spec, target=1).facts["target"] == plan.facts["ahead"]


def _reachable(table) -> list[list[int]]:
    result = []
    for start in range(len(table)):
        known, new = {start}, [start]
        while new:
            new = [int(there) for policy in new for there in table[policy] if there not in known]
            known.update(new)
        result.append(sorted(known))
    return result


@st.composite
def worlds(draw):
    policies, moves = draw(st.integers(1, 7)), draw(st.integers(1, 4))
    table = draw(
        st.lists(
            st.lists(st.integers(0, policies - 1), min_size=moves, max_size=moves),
            min_size=policies,
            max_size=policies,
        )
    )
    return np.array(table), draw(st.integers(0, policies - 1))


@given(worlds())
def test_paths_are_shortest(world):
    table, target = world
    points = np.random.default_rng(len(table)).normal(size=(len(table), 2))
    first = path_moves(table, points, target)
    reached = _reachable(table)
    for start in range(len(table)):
        goal = min(reached[start], key=lambda k: float(np.linalg.norm(points[k] - points[target])))
        fewest, layer = 0, {start}
        while goal not in layer:
            layer = {int(there) for policy in layer for there in table[policy]}
            fewest += 1
        policy = start
        for _ in range(fewest):
            policy = table[policy, first[policy]]
        assert policy == goal
        if goal == start:  # the move that keeps it, or leads nowhere nearer
            away = np.linalg.norm(points[table[start]] - points[start], axis=1)
            assert away[first[start]] == away.min()


def test_targets_and_lead_plans_that_do_not_exist_are_refused(spec):
    for target in (-1, 12, "7", True):
        refused("archive 'toy', 0 to 11", best_fixed, spec, target=target)
    for targets in [{"behind": 1}, {"behind": 1, "level": 2}, 3, {"behind": 1, "ahead": 12}]:
        refused(r"behind, ahead|index", best_lead_plan, spec, targets=targets)


PLAN = ["stay", "restraint +", "aggressiveness -", "stay"]
CHOICES = {"best-schedule": PLAN, "best-fixed": 3, "best-lead-plan": {"behind": 7, "ahead": 2}}
OPTIONS = {"best-schedule": "moves", "best-fixed": "target", "best-lead-plan": "targets"}


@pytest.mark.parametrize("kind", CHOICES)
def test_a_fit_is_kept_and_followed(spec, tmp_path, kind, seen):
    fit = make_fit(kind, CHOICES[kind], spec, {"races": 10, "reached": 0.5})
    path = save_fit(fit, tmp_path / "fit.yaml")
    assert vars(load_fit(path)) == vars(fit)
    assert fit.game == spec.identity._replace(elements=(), moves=())
    agent = build(kind, spec, fit=str(path))
    assert agent.facts["trained on"] == "races 10, reached 0.5"
    same = build(kind, spec, **{OPTIONS[kind]: CHOICES[kind]})
    assert (agent.act(seen[0]) == same.act(seen[0])).all()
    assert [entry.name for entry in tmp_path.iterdir()] == ["fit.yaml"]


def test_a_fit_of_another_game_is_refused(spec, archive):
    fit = make_fit("best-fixed", 3, spec, {})
    for change, message in [
        ({"epsilon": 0.7}, "epsilon"),
        ({"steps": (0.8,) * 4}, "games of 4 moves; the game has 3"),
    ]:
        refused(
            message,
            find_fit,
            "best-fixed",
            make_game(None, archive, replace(spec.rules, **change)),
            fit,
        )
    fewer = replace(archive, parameters=archive.parameters[1:], coordinates=archive.coordinates[1:])
    refused("was made for archive", find_fit, "best-fixed", make_game(None, fewer, spec.rules), fit)
    refused("is one of 'best-fixed'", find_fit, "best-schedule", spec, fit)
    for kind, option in OPTIONS.items():
        refused(
            f"agent '{kind}' got .* and a fit",
            build,
            kind,
            spec,
            fit=fit,
            **{option: CHOICES[kind]},
        )
    refused(
        "needs 'toy-paper-best-schedule'", find_fit, "best-schedule", spec, error=UnknownNameError
    )


def test_files_that_are_no_fit_are_refused(spec, tmp_path):
    for change, message in [
        ({"kind": "worst"}, "fit of 'worst' is unknown"),
        ({"choice": "7"}, "index of a policy"),
        ({"rules": 3}, "rules is 3"),
        ({"choice": True}, "index of a policy"),
        ({"epsilon": ["a"]}, "epsilon is"),
        ({"decisions": -1}, "decisions is -1"),
        ({"training": [1]}, r"training is \[1\]"),
    ]:
        path = save_fit(make_fit("best-fixed", 3, spec, {}), tmp_path / "fit.yaml")
        path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **change}))
        refused(message, load_fit, path)
