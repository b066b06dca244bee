"""Agents and solvers as plain Python: games on paper, networks that drive, moves that are drawn."""

import numpy as np

from pcs_racing import CONTEST, PAPER, draw_starts, get_planner, load_race_config, run_races
from pcs_racing.base.dense import DenseLayers
from pcs_racing.planners.network import INPUTS, network_planner
from pcs_racing.planners.trained import trained_planner
from pcs_racing_agents.agents.agent import draw, hash_rows
from pcs_racing_agents.learning.ppo.drives import LearnerEnv
from pcs_racing_agents.solvers import GameTree, cfr, exploitability, play_value, solve_exact
from pcs_racing_agents.solvers.cfr import VARIANTS
from pcs_racing_agents.solvers.matrix_games import solve_matrix_games


def layers(hidden=(5,), seed=0):
    """A small random network that sees what a driver sees."""
    rng = np.random.default_rng(seed)
    sizes = [len(INPUTS), *hidden, 2]
    shapes = list(zip(sizes[1:], sizes[:-1], strict=True))
    return DenseLayers(
        tuple(rng.normal(0.0, 0.3, shape).astype(np.float32) for shape in shapes),
        tuple(rng.normal(0.0, 0.1, shape[0]).astype(np.float32) for shape in shapes),
    )


def test_regrets_find_the_value_of_a_small_game():
    tree = GameTree.from_payoffs(np.random.default_rng(0).normal(size=(2, 2, 2, 2)))
    value = solve_exact(tree).value
    for variant in VARIANTS:
        found = cfr(tree, 60, variant=variant)
        open_to = exploitability(tree, found.average).nash_conv
        assert 0.0 <= open_to < 0.3, variant
        assert abs(play_value(tree, found.average) - value) <= open_to + 1e-12, variant


def test_neither_player_of_a_matrix_game_can_do_better():
    payoffs = np.random.default_rng(1).normal(size=(4, 3, 4))
    payoffs[3] = np.round(payoffs[3])  # moves that are equally good
    solved = solve_matrix_games(payoffs)
    for game, value, row, column in zip(payoffs, solved.values, solved.rows, solved.columns, strict=True):
        np.testing.assert_allclose([(row @ game).min(), (game @ column).max()], value, atol=1e-9)


def test_what_is_drawn_depends_on_what_was_seen_and_the_seed_alone():
    seen = np.random.default_rng(2).normal(size=(300, 4)).astype(np.float32)
    chances = np.tile([0.25, 0.0, 0.75], (300, 1))
    drawn = draw(chances, seen, 5)
    np.testing.assert_array_equal(draw(chances[7:9], seen[7:9], 5), drawn[7:9])
    assert (draw(chances, seen, 6) != drawn).any()
    assert abs(np.mean(drawn == 0) - 0.25) < 0.1
    assert not (drawn == 1).any()
    assert len(np.unique(hash_rows(seen, 5))) == 300


def test_a_driver_of_50_hz_is_a_network_planner(coarse_oval):
    config = load_race_config(CONTEST, duration=0.6, start_lines=1)
    rival = get_planner("pure-pursuit").policy()
    starts = draw_starts(coarse_oval, config, 1, 0)
    weights = layers()
    plain = network_planner("plain", (5,), weights.flat()).policy()
    ours = trained_planner("ours", weights, 2).policy()
    one, other = (run_races(coarse_oval, policy, rival, config, starts=starts, threads=1) for policy in (plain, ours))
    np.testing.assert_array_equal(one.state.cars, other.state.cars)
    assert one.state.progress[0, 0] > 0.1


def test_a_learner_sees_where_it_went(coarse_oval):
    """Alike in both races until one of them steers: then speed, steering and heading tell them apart."""
    opponent = get_planner("pure-pursuit").policy()
    races = LearnerEnv(
        2, track=coarse_oval, race=load_race_config(PAPER, duration=1.0), opponent=opponent, time_step=0.02
    )
    first, _ = races.reset(seed=4)
    assert first.shape == (2, len(INPUTS))
    for _ in range(5):
        observations, rewards, *_ = races.step(np.array([[0.0, 0.5], [0.8, 0.5]], np.float32))
    seen = dict(zip(INPUTS, observations.T, strict=True))
    assert (seen["speed"] > dict(zip(INPUTS, first.T, strict=True))["speed"]).all()
    assert seen["steering"][1] > seen["steering"][0] + 0.05
    assert rewards.shape == (2,)
