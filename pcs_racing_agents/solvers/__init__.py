"""Solvers of two-player zero-sum games on dense trees, and their evaluation."""

from pcs_racing_agents.solvers.cfr import VARIANTS, CFRResult, Variant, cfr
from pcs_racing_agents.solvers.compare import (
    METHODS,
    MethodRow,
    agreement,
    compare_methods,
    regret_argmax,
    solve,
)
from pcs_racing_agents.solvers.efg import efg_text, write_efg
from pcs_racing_agents.solvers.evaluation import (
    BestResponse,
    Exploitability,
    Profile,
    best_response,
    check_profile,
    exploitability,
    node_values,
    play_value,
    reach_probabilities,
    uniform_profile,
)
from pcs_racing_agents.solvers.exact import ExactResult, solve_exact
from pcs_racing_agents.solvers.game_tree import GameTree
from pcs_racing_agents.solvers.matrix_games import MatrixSolution, solve_matrix_games
