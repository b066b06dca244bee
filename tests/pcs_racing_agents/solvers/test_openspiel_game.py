import numpy as np
import pytest
from small_games import kuhn_poker, random_tree

from pcs_racing.base.errors import InputError
from pcs_racing_agents.solvers import cfr, exploitability, solve_exact, solve_matrix_games

pyspiel = pytest.importorskip("pyspiel", reason="OpenSpiel is not installed")

from pcs_racing_agents.solvers.openspiel import (  # noqa: E402
    GAME_NAME,
    python_game,
    register_game,
    register_tree,
)

TREE = random_tree(0, 2, 3, 2, 2)


def sequential(tree):
    return pyspiel.convert_to_turn_based(python_game(tree))


def states_below(state):
    """A state and all that can follow, both cars moving at once."""
    yield state
    if state.is_chance_node():
        for action, _ in state.chance_outcomes():
            yield from states_below(state.child(action))
    elif not state.is_terminal():
        for first in state.legal_actions(0):
            for second in state.legal_actions(1):
                child = state.clone()
                child.apply_actions([first, second])
                yield from states_below(child)


def test_the_game_is_registered():
    register_game()
    assert GAME_NAME in pyspiel.registered_names()
    game = pyspiel.load_game(GAME_NAME)
    assert game.get_type().dynamics == pyspiel.GameType.Dynamics.SIMULTANEOUS
    pyspiel.random_sim_test(game, num_sims=3, serialize=True, verbose=False)
    register_tree("mine", TREE)
    assert pyspiel.load_game(GAME_NAME, {"tree": "mine"}).num_distinct_actions() == 3


@pytest.mark.parametrize(
    "tree", [TREE, random_tree(1, 2, 2, 2, 3, chance=3, blur=2), kuhn_poker()], ids=["plain", "blurred", "kuhn"]
)
def test_what_is_known_is_the_infoset(tree):
    """Payoffs are the leaves; strings and tensors are equal exactly where a car can't tell nodes apart."""
    game = python_game(tree)
    seen: dict[tuple[int, bytes], set[str]] = {}
    leaves = []
    for state in states_below(game.new_initial_state()):
        if state.is_terminal():
            leaves.append(state.returns()[0])
            assert sum(state.returns()) == 0.0
        elif not state.is_chance_node():
            for player in (0, 1):
                tensor = np.array(state.information_state_tensor(player), dtype=np.float32)
                assert len(tensor) == game.information_state_tensor_size()
                assert np.array_equal(tensor, state.observation_tensor(player))
                seen.setdefault((player, tensor.tobytes()), set()).add(state.information_state_string(player))
    assert leaves == tree.payoffs.reshape(-1).tolist()
    assert all(len(strings) == 1 for strings in seen.values())
    for player in (0, 1):
        rows = sum(tree.rows(k, player) for k in range(tree.depth))
        assert sum(key[0] == player for key in seen) == rows
        assert len({string for key, strings in seen.items() if key[0] == player for string in strings}) == rows


def test_a_tensor_says_which_moves_led_there():
    """Where everything is seen: whose it is, the level, then the own and the other car's moves."""
    for first in range(2):
        for second in range(3):
            state = python_game(TREE).new_initial_state()
            state.apply_actions([first, second])
            level, own, other = (0.0, 1.0), np.eye(2)[first], np.eye(3)[second]
            assert state.information_state_tensor(0) == [1.0, 0.0, *level, *own, *other]
            assert state.information_state_tensor(1) == [0.0, 1.0, *level, *other, *own]


def test_copies_share_the_tree():
    state = python_game(TREE).new_initial_state()
    state.apply_actions([1, 2])
    other = state.clone()
    other.apply_actions([0, 0])
    assert other.data is state.data
    assert (state.level, other.level) == (1, 2)


def test_tensors_of_your_own():
    rng = np.random.default_rng(0)
    seen = [tuple(rng.random((TREE.rows(k, car), 4), dtype=np.float32) for car in (0, 1)) for k in range(2)]
    state = python_game(TREE, seen).new_initial_state()
    state.apply_actions([1, 1])
    assert state.information_state_tensor(1)[2:] == pytest.approx(seen[1][1][1 * 3 + 1])
    with pytest.raises(InputError, match="row for every infoset"):
        python_game(TREE, seen[:1])


def test_unknown_trees():
    register_game()
    with pytest.raises(InputError, match=r"tree .*'nowhere'"):
        pyspiel.load_game(GAME_NAME, {"tree": "nowhere"})


def test_cfr():
    from open_spiel.python.algorithms import cfr as theirs
    from open_spiel.python.algorithms.exploitability import exploitability as judge

    game = sequential(TREE)
    compiled, plain = pyspiel.CFRSolver(game), theirs.CFRSolver(game)
    for _ in range(9):
        compiled.evaluate_and_update_policy()
        plain.evaluate_and_update_policy()
    ours = exploitability(TREE, cfr(TREE, 9, "alternating").average).exploitability
    assert pyspiel.exploitability(game, compiled.tabular_average_policy()) == pytest.approx(ours, rel=1e-10)
    assert judge(game, plain.average_policy()) == pytest.approx(ours, rel=1e-10)


def test_external_sampling():
    game = sequential(TREE)
    solver = pyspiel.ExternalSamplingMCCFRSolver(game, seed=3)
    for _ in range(1000):
        solver.run_iteration()
    assert pyspiel.exploitability(game, solver.average_policy()) < 0.1


@pytest.mark.compare
def test_psro_and_alpha_rank():
    """Best responses added to a meta-game until nobody gains; then the ranks of what was found."""
    pytest.importorskip("cvxpy", reason="cvxpy, which OpenSpiel's PSRO imports, is not installed")
    from open_spiel.python import policy
    from open_spiel.python.algorithms import exploitability as judge
    from open_spiel.python.algorithms import policy_aggregator
    from open_spiel.python.algorithms.psro_v2 import best_response_oracle, psro_v2
    from open_spiel.python.egt import alpharank

    def equilibrium(solver, return_joint=False):
        solution = solve_matrix_games(solver.get_meta_game()[0])
        shares = [solution.rows[0], solution.columns[0]]
        return (shares, np.outer(*shares).reshape(-1)) if return_joint else shares

    def always_the_first_move():
        pure = policy.TabularPolicy(game)
        pure.action_probability_array[:] = 0.0
        pure.action_probability_array[:, 0] = 1.0
        return pure

    game = sequential(TREE)
    solver = psro_v2.PSROSolver(
        game,
        best_response_oracle.BestResponseOracle(game=game, policy=policy.TabularPolicy(game)),
        initial_policies=[always_the_first_move(), always_the_first_move()],
        sims_per_entry=1,  # of pure policies without chance: exact
        meta_strategy_method=equilibrium,
        training_strategy_selector="probabilistic",
        sample_from_marginals=True,
    )
    for _ in range(6):
        solver.iteration()
    mixed = policy_aggregator.PolicyAggregator(game).aggregate(
        range(2), solver.get_policies(), solver.get_meta_strategies()
    )
    payoffs = [np.asarray(table) for table in solver.get_meta_game()]
    assert judge.nash_conv(game, mixed, use_cpp_br=False) == pytest.approx(0.0, abs=1e-6)
    assert solve_matrix_games(payoffs[0]).values[0] == pytest.approx(solve_exact(TREE).value)
    ranks = alpharank.compute(payoffs, alpha=1.0)[2]
    assert ranks.shape == (payoffs[0].size,)
    assert ranks.sum() == pytest.approx(1.0)
