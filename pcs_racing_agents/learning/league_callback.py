"""Callback of Stable-Baselines3 for a league: difficulty rises with success."""

from pcs_racing.base.errors import say_once
from pcs_racing.envs.infos import Result
from pcs_racing_agents.learning.league import League

try:
    from stable_baselines3.common.callbacks import BaseCallback
except ImportError as error:
    raise ImportError(
        "pcs_racing_agents.learning.league_callback needs Stable-Baselines3:"
        ' pip install "pcs-racing[learning]"'
    ) from error


class LeagueCallback(BaseCallback):
    """Count the races against each opponent, and set the weights of the draw after each rollout.

    The opponents of the training's environment are ``league.opponents()``. ``callback.league`` is
    the league with the races so far.
    """

    def __init__(self, league: League) -> None:
        super().__init__()
        self.league = league
        self._ended: list[tuple[int, int]] = []

    def _on_step(self) -> bool:
        ends = [info for info in self.locals["infos"] if "episode" in info]
        self._ended += [(info["opponent"], info["result"]) for info in ends]
        return True

    def _on_rollout_end(self) -> None:
        if self._ended and all(result == Result.CRASH for _, result in self._ended):
            say_once(
                "no race of the league counts: each ended in a crash, a no-contest under these"
                " rules; make the environment with rules='contest'"
            )
        if self._ended:
            self.league = self.league.record(*zip(*self._ended, strict=True))
            self._ended = []
        self.training_env.set_opponent_weights(self.league.weights())  # type: ignore[attr-defined]
        for member in self.league.members:
            self.logger.record(f"league/won against {member.name}", member.won_share)
