# /// script
# dependencies = ["benchmarl==1.5.2"]
# ///
"""BenchMARL: train MAPPO by self-play, with moves or with steering and speed.

    python examples/clients/benchmarl_mappo.py

``BothCars`` is a task of BenchMARL: it names the environment, its groups of agents and its spaces.
"""

import tempfile
from collections.abc import Callable
from typing import Any

from benchmarl.algorithms import MappoConfig
from benchmarl.environments.common import Task, TaskClass
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from torchrl.data import Composite
from torchrl.envs import EnvBase, PettingZooWrapper

import pcs_racing
from pcs_racing.envs import drive


class BothCars(TaskClass):
    """A race as a task of BenchMARL: the group ``car`` holds both cars."""

    @property
    def steered(self) -> bool:
        """True if the agents steer; else they make moves."""
        return self.name == "DRIVE_HEAD_TO_HEAD"

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """Return the function that makes an environment."""
        make = drive.parallel_env if self.steered else pcs_racing.parallel_env
        return lambda: PettingZooWrapper(make(**self.config), categorical_actions=True, seed=seed)

    def supports_continuous_actions(self) -> bool:
        """Steering is continuous."""
        return self.steered

    def supports_discrete_actions(self) -> bool:
        """Moves are discrete."""
        return not self.steered

    def has_render(self, env: EnvBase) -> bool:
        """No pictures here."""
        return False

    def max_steps(self, env: EnvBase) -> int:
        """Steps of an episode."""
        return 50 if self.steered else 4

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """Return the groups of agents."""
        return env.group_map

    def observation_spec(self, env: EnvBase) -> Composite:
        """Return the observation spaces."""
        spec = env.observation_spec.clone()
        for group in self.group_map(env):
            for key in list(spec[group].keys()):
                if key != "observation":
                    del spec[group, key]
        return spec

    def info_spec(self, env: EnvBase) -> Composite | None:
        """Infos are not used."""
        return None

    def state_spec(self, env: EnvBase) -> Composite | None:
        """The critic sees both observations; no state is needed."""
        return None

    def action_spec(self, env: EnvBase) -> Composite:
        """Return the action spaces."""
        return env.full_action_spec

    def action_mask_spec(self, env: EnvBase) -> Composite | None:
        """Every move may be made."""
        return None

    @staticmethod
    def env_name() -> str:
        """Name in logs."""
        return "pcs_racing"


class Tasks(Task):
    """Tasks of this file."""

    HEAD_TO_HEAD = None
    DRIVE_HEAD_TO_HEAD = None

    @staticmethod
    def associated_class() -> type[TaskClass]:
        """Return the class above."""
        return BothCars


def train(task: TaskClass, folder: str) -> None:
    """Train for a few steps with BenchMARL's files in a folder, and print the mean return."""
    config = ExperimentConfig.get_from_yaml()
    config.max_n_frames = config.on_policy_collected_frames_per_batch = 64
    config.on_policy_n_envs_per_worker, config.on_policy_n_minibatch_iters = 2, 1
    config.on_policy_minibatch_size, config.evaluation, config.loggers = 32, False, []
    config.save_folder = folder
    config.create_json, config.checkpoint_at_end, config.render = False, False, False
    experiment = Experiment(
        task=task,
        algorithm_config=MappoConfig.get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        critic_model_config=MlpConfig.get_from_yaml(),
        seed=0,
        config=config,
    )
    experiment.run()
    print(
        f"{task.name}: {experiment.total_frames} steps of both cars, mean return"
        f" {float(experiment.mean_return):+.2f}"
    )


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        train(Tasks.HEAD_TO_HEAD.get_task(config={"track": "Tarnfjord"}), folder)
        train(
            Tasks.DRIVE_HEAD_TO_HEAD.get_task(config={"track": "Tarnfjord", "duration": 1.0}),
            folder,
        )


if __name__ == "__main__":
    main()
