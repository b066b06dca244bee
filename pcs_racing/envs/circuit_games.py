"""The game on every circuit that the episodes of a batch are on, with the opponents in it."""

from dataclasses import replace
from typing import Any

from pcs_racing.base.recently_used import RecentlyUsed
from pcs_racing.envs.opponents import Opponent, parse_opponents, shared_planner
from pcs_racing.envs.variety import Variety
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.config import GameConfig
from pcs_racing.game.rules import RaceGame

KEPT = 64  # games on circuits that no episode is on


class CircuitGames:
    """Games by the number of their circuit, made when they are first asked for; the last ones used are kept.

    Parameters
    ----------
    variety : Variety
        Circuits and cars of the batch.
    opponent : see :func:`pcs_racing.envs.opponents.parse_opponents`
        None where players move both cars.
    threads : int, optional
        Threads that share a step of a game.
    """

    def __init__(
        self, variety: Variety, archive: PolicyArchive, rules: GameConfig, opponent: Any, threads: int | None
    ) -> None:
        self._variety, self._archive, self._rules = variety, archive, rules
        self._opponent, self._threads = opponent, threads
        self._games: RecentlyUsed[int, tuple[RaceGame, list[Opponent]]] = RecentlyUsed(KEPT + variety.episodes)

    def on(self, circuit: int) -> tuple[RaceGame, list[Opponent]]:
        """Return the game on a circuit, by its number, and the opponents in it."""
        return self._games.get(circuit, lambda: self._make(circuit))

    def _make(self, circuit: int) -> tuple[RaceGame, list[Opponent]]:
        game = RaceGame(
            self._variety.circuits.track(circuit),
            self._archive,
            self._rules,
            threads=self._threads,
            vehicles=self._variety.cars,
            most_delay=self._variety.randomization.most_delay,
        )
        opponents = [] if self._opponent is None else parse_opponents(self._opponent, game)
        planner = shared_planner(opponents, game)
        if planner is not game.setup.planners[1]:
            game = replace(game, opponent_planner=planner)
        return game, opponents
