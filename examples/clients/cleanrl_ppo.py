# /// script
# dependencies = ["gym==0.23.1", "tensorboard==2.21.0", "torch", "tyro==1.0.17"]
# ///
"""CleanRL: train its unmodified ``ppo.py`` on the duel.

    python examples/clients/cleanrl_ppo.py
    python examples/clients/cleanrl_ppo.py --file CHECKOUT/cleanrl/ppo.py

CleanRL's release 1.2.0 requires Python below 3.11 and gym 0.23, so ``ppo.py`` is extracted from the
downloaded package, and :class:`Duel` gives the environment the interface of gym 0.23. The
``ppo.py`` of a checkout (``--file``) uses Gymnasium and makes the environment by its name.
"""

import argparse
import os
import runpy
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import gym
import gymnasium

import pcs_racing

gymnasium.register_envs(pcs_racing)

RELEASE = "cleanrl==1.2.0"


class Duel(gym.Env):
    """The duel with the interface of gym 0.23: ``reset`` returns the observation alone, and
    ``step`` four values.
    """

    metadata: dict[str, Any] = {"render.modes": []}  # noqa: RUF012

    def __init__(self) -> None:
        self.env = gymnasium.make("pcs_racing/Duel-v1")
        space, moves = self.env.observation_space, self.env.action_space
        self.observation_space = gym.spaces.Box(space.low, space.high, dtype=space.dtype)
        self.action_space = gym.spaces.Discrete(int(moves.n))
        self._seed: int | None = None

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Store the seed for the next reset."""
        self._seed = seed
        return [seed]

    def reset(self, **_: Any) -> Any:
        """Begin a game."""
        observation, _ = self.env.reset(seed=self._seed)
        self._seed = None
        return observation

    def step(self, action: Any) -> tuple[Any, float, bool, dict[str, Any]]:
        """Make a move."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, float(reward), terminated or truncated, info


def download(folder: Path) -> Path:
    """Extract ``ppo.py`` from the released package."""
    pip = [
        sys.executable,
        "-m",
        "pip",
        "--disable-pip-version-check",
        "download",
        "--quiet",
        "--no-deps",
    ]
    subprocess.run(
        [*pip, "--python-version", "3.10", "--only-binary=:all:", "-d", folder, RELEASE], check=True
    )
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as package:
        return Path(package.extract("cleanrl/ppo.py", folder))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--file", type=Path, help="ppo.py of a checkout (default: CleanRL 1.2.0)")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if given.file is None:
            gym.register("Duel-v1", entry_point=Duel)
            file, name = download(Path(folder)), "Duel-v1"
        else:
            file, name = given.file.resolve(), "pcs_racing/Duel-v1"
        os.chdir(folder)  # it writes its curves to runs/
        sys.argv = [file.name, "--env-id", name, "--total-timesteps", "512", "--num-steps", "32"]
        runpy.run_path(str(file), run_name="__main__")


if __name__ == "__main__":
    main()
