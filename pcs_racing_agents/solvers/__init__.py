"""Solvers of two-player zero-sum games on dense trees: exact and by regret minimisation, and their
evaluation.
"""

from pcs_racing_agents.solvers.cfr import VARIANTS, CFRResult, Variant, cfr
from pcs_racing_agents.solvers.compare import (
    METHODS,
    MethodRow,
    agreement,
    compare_methods,
    regret_argmax,
)
from pcs_racing_agents.solvers.efg import efg_text, infoset_name, write_efg
from pcs_racing_agents.solvers.evaluation import (
    BestResponse,
    Exploitability,
    Profile,
    advantages,
    best_response,
    check_profile,
    exploitability,
    node_values,
    play_value,
    q_values,
    reach_probabilities,
    uniform_profile,
)
from pcs_racing_agents.solvers.exact import (
    ExactResult,
    SequenceSolution,
    solve_exact,
    solve_sequence_form,
)
from pcs_racing_agents.solvers.game_tree import GameTree
from pcs_racing_agents.solvers.matrix_games import MatrixSolution, solve_matrix_games
