"""Record races of a policy as a Minari dataset, for offline learning and imitation.

    pip install "minari[hdf5]"
    python examples/record_dataset.py
    python examples/record_dataset.py --expert lattice:pace=0.8 --opponent cfr-argmax --beams 108

The expert is any policy; it drives car 0 of ``pcs_racing/Drive-v1`` against any policy or agent.
The action of a step of 0.02 s is the command of the expert. The dataset lies in Minari's folder of
datasets; the last lines read it again.
"""

import argparse

import gymnasium
import numpy as np

try:
    import h5py  # noqa: F401  for Minari
    import minari
    from minari.data_collector import EpisodeBuffer
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install "minari[hdf5]"') from None

import pcs_racing
from pcs_racing import game
from pcs_racing.planners import Policy

TOP_SPEED = 12.0  # m/s, above the speeds of all planners


class Expert:
    """Commands of a policy for car 0 of an environment, for every step."""

    def __init__(self, env: gymnasium.Env, policy: Policy) -> None:
        self.batch = env.unwrapped.batch
        setup, cars = self.batch.setup, self.batch.cars
        # The policy drives all cars of this copy of the race; only the command of car 0 is used.
        self.setup = game.RaceSetup(setup.track, setup.rules, (policy.planner,) * cars)
        self.theta = game.pad_parameters([policy] * cars, self.setup.theta_size)[None]

    def begin(self) -> None:
        """Reset the memory of the policy before a race."""
        self.kept = (
            np.zeros((1, self.batch.cars, self.setup.memory_size)),
            np.zeros_like(self.batch.state.path),
        )

    def command(self) -> np.ndarray:
        """Return the commanded steering angle (rad) and speed (m/s), without noise."""
        copy = game.RaceState._make(np.array(part) for part in self.batch.state)
        copy = copy._replace(memory=self.kept[0], path=self.kept[1])
        game.advance(self.setup, copy, self.theta, game.CONTROL_EVERY, threads=1, ittc=False)
        self.kept = copy.memory, copy.path
        return copy.command[0, 0] - [copy.disturbance[0, 0], 0.0]


def record(
    name: str, planner: str, opponent: str | None, races: int, seed: int, **options
) -> minari.MinariDataset:
    """Drive races with an expert in car 0 and save them as a dataset."""
    env = gymnasium.make(
        "pcs_racing:pcs_racing/Drive-v1",
        opponent=opponent,
        time_step=game.CONTROL_EVERY * game.DT,
        normalized=False,
        top_speed=TOP_SPEED,
        **options,
    )
    expert = Expert(env, pcs_racing.racer(planner))
    episodes = []
    for race in range(races):
        observation, _ = env.reset(seed=seed + race)
        expert.begin()
        # Observations before every step and after the last one; actions and results of every step.
        observations, steps, over = [observation], [], False
        while not over:
            action = np.clip(expert.command(), env.action_space.low, env.action_space.high).astype(
                np.float32
            )
            observation, *result, _ = env.step(action)
            observations.append(observation)
            steps.append((action, *result))
            over = any(result[1:])
        names = ("actions", "rewards", "terminations", "truncations")
        columns = {
            name: np.array(column)
            for name, column in zip(names, zip(*steps, strict=True), strict=True)
        }
        episodes.append(
            EpisodeBuffer(id=race, seed=seed + race, observations=np.array(observations), **columns)
        )
    about = f"{planner} against {opponent}, {options}"
    dataset = minari.create_dataset_from_buffers(
        name, episodes, env=env, algorithm_name=planner, description=about
    )
    env.close()
    return dataset


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--name", default="pcs-racing/lattice-v0", help="name of the new dataset")
    parser.add_argument("--expert", default="lattice", help="policy in car 0")
    parser.add_argument(
        "--opponent", default="lattice:pace=0.6", help="policy or agent in car 1, or none"
    )
    parser.add_argument(
        "--track", default="Brackwater", help="name of a shipped track or a map folder"
    )
    parser.add_argument("--rules", default="paper", help="rules: paper, contest or a YAML file")
    parser.add_argument("--races", type=int, default=10, help="number of races")
    parser.add_argument("--duration", type=float, default=40.0, help="length of a race in s")
    parser.add_argument("--beams", type=int, default=0, help="lidar beams of an observation")
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of the first race; race k has seed + k"
    )
    given = parser.parse_args()
    if given.name in minari.list_local_datasets():
        parser.error(f"the dataset {given.name} exists; choose another --name")

    opponent = None if given.opponent == "none" else given.opponent
    options = {
        "track": given.track,
        "rules": given.rules,
        "duration": given.duration,
        "beams": given.beams,
    }
    record(given.name, given.expert, opponent, given.races, given.seed, **options)
    dataset = minari.load_dataset(given.name)
    returns = [float(episode.rewards.sum()) for episode in dataset.iterate_episodes()]
    print(
        f"{given.name}: {dataset.total_episodes} races, {dataset.total_steps} steps, mean return"
        f" {np.mean(returns):.1f}"
    )
    print(f"observations {dataset.observation_space.shape}, actions {dataset.action_space.shape}")


if __name__ == "__main__":
    main()
