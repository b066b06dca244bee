"""The Python game behind :mod:`pcs_racing_agents.solvers.openspiel`: a simultaneous-move game with tensors."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing_agents.solvers.game_tree import GameTree


def information_tensors(tree: GameTree) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Information-state tensors of each level and player, shape (rows, D).

    The step (one of m), then for each step so far: the own last move (one of its moves) and the observation: the
    other's last move where both see all past moves, and else the infoset's number in binary.
    """
    m = tree.depth
    observed_moves = tree.perfect and tree.roots == 1
    pairs = []
    for player in (0, 1):
        own, other = ([moves[p] for moves in tree.moves] for p in (player, 1 - player))
        bits = [max(1, (tree.rows(k, player) - 1).bit_length()) for k in range(m)]
        blocks = [0, *own[:-1]]
        sizes = [blocks[k] + ([0, *other[:-1]][k] if observed_moves else bits[k]) for k in range(m)]
        at = np.cumsum([m, *sizes])
        levels = []
        before = np.zeros((tree.roots, at[-1]), dtype=np.float32)
        for k in range(m):
            if k:
                a, b = tree.moves[k - 1]
                node = np.arange(tree.nodes(k))
                before = before[node // (a * b)]
                moves = ((node // b) % a, node % b)
                before[node, at[k] + moves[player]] = 1.0
                if observed_moves:
                    before[node, at[k] + blocks[k] + moves[1 - player]] = 1.0
            rows = tree.infosets[k][player]
            if not observed_moves:
                digits = (rows[:, None] >> np.arange(bits[k])) & 1
                before[:, at[k] + blocks[k] : at[k + 1]] = digits
            first = np.unique(rows, return_index=True)[1]
            table = before[first]
            table[:, k] = 1.0
            levels.append(table)
        pairs.append(levels)
    width = max(levels[0].shape[1] for levels in pairs)
    padded = [[np.pad(table, ((0, 0), (0, width - table.shape[1]))) for table in levels] for levels in pairs]
    return list(zip(*padded, strict=True))


def register(name: str, default: str, find: Callable[[str], tuple[GameTree, Any]]) -> None:
    """Define the game for OpenSpiel and register it.

    Parameters
    ----------
    name : str
        Short name of the game.
    default : str
        Its parameter ``tree``, if none is given.
    find : callable
        Returns the tree of a name and its tensors or None.
    """
    import pyspiel

    def game_type(chance: bool) -> Any:
        return pyspiel.GameType(
            short_name=name,
            long_name="pcs-racing: a game tree of moves in Policy Characteristic Space",
            dynamics=pyspiel.GameType.Dynamics.SIMULTANEOUS,
            chance_mode=pyspiel.GameType.ChanceMode.EXPLICIT_STOCHASTIC
            if chance
            else pyspiel.GameType.ChanceMode.DETERMINISTIC,
            information=pyspiel.GameType.Information.IMPERFECT_INFORMATION,
            utility=pyspiel.GameType.Utility.ZERO_SUM,
            reward_model=pyspiel.GameType.RewardModel.TERMINAL,
            max_num_players=2,
            min_num_players=2,
            provides_information_state_string=True,
            provides_information_state_tensor=True,
            provides_observation_string=True,
            provides_observation_tensor=True,
            provides_factored_observation_string=False,
            parameter_specification={"tree": default},
        )

    class TreeGame(pyspiel.Game):
        """A tree; states and observers come from here."""

        def __init__(self, params: Any = None) -> None:
            parameters = {"tree": default, **(params or {})}
            tree, observations = find(parameters["tree"])
            chance = tree.roots > 1
            info = pyspiel.GameInfo(
                num_distinct_actions=max(max(pair) for pair in tree.moves),
                max_chance_outcomes=tree.roots if chance else 0,
                num_players=2,
                min_utility=-float(np.abs(tree.payoffs).max()),
                max_utility=float(np.abs(tree.payoffs).max()),
                utility_sum=0.0,
                max_game_length=tree.depth,
            )
            super().__init__(game_type(chance), info, parameters)
            self.data = _Data(tree, observations)

        def new_initial_state(self) -> Any:
            """Return the state before anything happened."""
            return TreeState(self, self.data)

        def make_py_observer(self, iig_obs_type: Any = None, params: Any = None) -> Any:
            """Return what fills the tensors."""
            if params:
                raise ValueError(f"observation parameters are not supported: {params}")
            return TreeObserver(self.data, iig_obs_type)

    class TreeState(pyspiel.State):
        """A node of the tree: its level and its number there."""

        def __init__(self, game: Any, data: "_Data") -> None:
            super().__init__(game)
            self.data = data
            self.level = 0 if data.tree.roots == 1 else -1
            self.node = 0

        def current_player(self) -> int:
            """Return who acts: chance, both players, or none at the end."""
            if self.level < 0:
                return pyspiel.PlayerId.CHANCE
            return pyspiel.PlayerId.TERMINAL if self.is_terminal() else pyspiel.PlayerId.SIMULTANEOUS

        def _legal_actions(self, player: int) -> list[int]:
            return list(range(self.data.tree.moves[self.level][player]))

        def chance_outcomes(self) -> list[tuple[int, float]]:
            """Return the roots and their probabilities."""
            return list(enumerate(self.data.tree.chance.tolist()))

        def _apply_action(self, action: int) -> None:
            self.level, self.node = 0, action

        def _apply_actions(self, actions: list[int]) -> None:
            a, b = self.data.tree.moves[self.level]
            self.node = (self.node * a + actions[0]) * b + actions[1]
            self.level += 1

        def _action_to_string(self, player: int, action: int) -> str:
            return f"root {action}" if player == pyspiel.PlayerId.CHANCE else f"move {action}"

        def is_terminal(self) -> bool:
            """Return whether all moves are made."""
            return self.level == self.data.tree.depth

        def returns(self) -> list[float]:
            """Return what each car gets; 0 before the end."""
            if not self.is_terminal():
                return [0.0, 0.0]
            payoff = float(self.data.payoffs[self.node])
            return [payoff, 0.0 - payoff]

        def __str__(self) -> str:
            return f"{self.level}:{self.node}"

    class TreeObserver:
        """Fills tensors and names information states (OpenSpiel's ``PyObserver``)."""

        def __init__(self, data: "_Data", kind: Any) -> None:
            self.data = data
            self.private = kind is None or kind.private_info == pyspiel.PrivateInfoType.SINGLE_PLAYER
            self.tensor = np.zeros(2 + data.width, np.float32)
            self.dict = {"player": self.tensor[:2], "seen": self.tensor[2:]}

        def set_from(self, state: Any, player: int) -> None:
            """Write a player's information state into the tensor."""
            self.tensor[:] = 0.0
            self.tensor[player] = 1.0
            if self.private and 0 <= state.level < self.data.tree.depth:
                row = self.data.tree.infosets[state.level][player][state.node]
                self.tensor[2:] = self.data.tensors[state.level][player][row]

        def string_from(self, state: Any, player: int) -> str:
            """Return the name of a player's information state: its level and its row in a strategy."""
            if not self.private or state.level < 0:
                return f"{player}:{state.level}"
            if state.is_terminal():
                return f"{player}:{state.level}:{state.node}"
            return f"{player}:{state.level}:{self.data.tree.infosets[state.level][player][state.node]}"

    pyspiel.register_game(game_type(True), TreeGame)


class _Data:
    """Data that all states of a game share; OpenSpiel's deep copies of states keep a reference to it."""

    def __init__(self, tree: GameTree, tensors: Any) -> None:
        self.tree = tree
        self.payoffs = tree.payoffs.reshape(-1)
        self.tensors = information_tensors(tree) if tensors is None else tensors
        self.width = self.tensors[0][0].shape[1]

    def __deepcopy__(self, memo: dict[int, Any]) -> "_Data":
        return self
