"""Control-level self-play between unequal cars; one policy learns to pass and to be passed.

Against only its equal, a policy forgets how to pass: no car is slower, and the other car always
makes room. In every race one of the two cars therefore has a reduced speed, and in half of the
races this car does not see the other car.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.checks import check_number

try:
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
except ImportError as error:
    raise ImportError(
        'self-play needs Stable-Baselines3: pip install "pcs-racing[learning]"'
    ) from error


class UnequalCars(VecEnvWrapper):
    """Self-play with one slower car per race, blind in half of the races; redrawn for each race.

    Parameters
    ----------
    venv : VecEnv
        Races of two cars (``make_sb3_vec_env("drive-self-play", ...)``): environments ``2 i`` and
        ``2 i + 1`` are the cars of race ``i``.
    slowest : float
        Minimum speed share of the slower car of a race, in (0, 1].
    seed : int
        Seed of the random draws.
    """

    def __init__(self, venv: VecEnv, slowest: float = 0.5, seed: int = 0) -> None:
        super().__init__(venv)
        self.slowest = check_number("slowest", slowest, 0.01, 1.0)
        names = [element.name for element in venv.get_attr("elements", 0)[0]]
        self.about_opponent = np.array(
            [name == "lead" or name.startswith("opponent") for name in names]
        )
        self.rng = np.random.default_rng(seed)
        self.speed, self.blind = np.ones(venv.num_envs), np.zeros(venv.num_envs, np.bool_)

    def reset(self) -> NDArray[np.float32]:
        """Begin new races, and draw the slower car of each."""
        self._draw(np.arange(self.num_envs // 2))
        return self._hide(self.venv.reset())  # type: ignore[arg-type]

    def step_async(self, actions: NDArray[Any]) -> None:
        """Forward the actions, with each car's speed multiplied by its share."""
        # An action of -1 is a standstill: the share applies to the speed, not to the action.
        speed = self.speed * (1.0 + np.clip(actions[:, 1], -1.0, 1.0)) - 1.0
        self.venv.step_async(np.stack([actions[:, 0], speed], axis=1))

    def step_wait(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Complete the step; after the end of a race, draw its slower car again."""
        observations, rewards, done, infos = self.venv.step_wait()
        for i in np.flatnonzero(done & self.blind):
            infos[i]["terminal_observation"] = np.where(
                self.about_opponent, 0.0, infos[i]["terminal_observation"]
            )
        self._draw(np.flatnonzero(done[::2]))
        return self._hide(observations), rewards, done, infos  # type: ignore[arg-type]

    def _draw(self, races: NDArray[np.int64]) -> None:
        """Draw the slower car of each race, its speed share, and its blindness."""
        slow = 2 * races + self.rng.integers(2, size=len(races))
        both = np.concatenate([2 * races, 2 * races + 1])
        self.speed[both], self.blind[both] = 1.0, False
        self.speed[slow] = self.rng.uniform(self.slowest, 1.0, len(races))
        self.blind[slow] = self.rng.random(len(races)) < 0.5

    def _hide(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Set the opponent elements of blind cars' observations to 0."""
        return np.where(self.blind[:, None] & self.about_opponent, np.float32(0.0), observations)
