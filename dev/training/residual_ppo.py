"""Train a driver that corrects a potential field by PPO, write its folder, and count its own
crashes alone.

    python dev/training/residual_ppo.py --out out/residual

Two cars race, both driven by the network that learns, some of them at a share of its speed; one
half starts 50 m apart, as good as alone. Every 0.1 s a car is rewarded for its progress and for
what it gains on the other one, and a crash by its own fault costs as much as half a minute.
Circuits are those that ship, but for the ones that are held out, and random ones.
"""

import argparse
from pathlib import Path

import numpy as np

try:
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecEnv
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[learning]"') from None
from gymnasium import spaces

from pcs_racing import CONTEST, load_track, run_races
from pcs_racing.base.compilation import compiled
from pcs_racing.planners.field.lidar_networks import load_lidar_planner, save_lidar_planner
from pcs_racing.planners.field.residual import SCRATCH, SEEN, lay_corrected, observe
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.view import VIEW_SIZE
from pcs_racing.race.calibration import calibration_of
from pcs_racing.race.conditions import vehicle_rows
from pcs_racing.race.config import RaceConfig
from pcs_racing.race.kernel import fill_view
from pcs_racing.race.races import RaceSetup, advance, start_races
from pcs_racing.race.random_circuits import RandomCircuits, random_circuit
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.maps import list_tracks
from pcs_racing.track.track import Track

STEP = 10  # simulation steps of 0.01 s
SECONDS = 20.0
NOISE = 0.02  # rad
# reward for a metre, for a metre gained on the other car, against a crash
PROGRESS, GAIN, FAULT = 0.1, 0.05, 25.0


@compiled
def _plan(track, theta, view, memory, scratch, path):
    """Drive by the corrections that stand in theta."""
    seen = scratch[SCRATCH : SCRATCH + SEEN]
    steering, speed = observe(track, view, scratch, seen)
    lay_corrected(view, steering, speed, theta[0], theta[1], theta[2], path)


CORRECTED = Planner(
    name="corrected",
    parameters=tuple(
        Parameter(name, -1.0, 1.0, 0.0, "correction") for name in ("turn", "faster", "speed_share")
    ),
    plan=_plan,
    scratch_size=SCRATCH + SEEN,
)


@compiled
def _observe_all(track, state, vehicles, settings, out):
    """Write what the driver of each car sees, shape (races, 2, SEEN)."""
    scratch, view = np.empty(SCRATCH), np.empty(VIEW_SIZE)
    for race in range(len(state.tick)):
        for car in range(2):
            fill_view(track, state, race, car, vehicles, settings, view)
            observe(track, view, scratch, out[race, car])


class Races:
    """Some races on one circuit, each of which begins anew when it ends."""

    def __init__(self, track: Track, races: int, gap: float, rng: np.random.Generator) -> None:
        config = RaceConfig(
            start="rolling",
            start_gap=gap,
            start_spacing=0.0,
            steering_noise=NOISE,
            speed_range=(0.8, 1.2),
            duration=SECONDS,
        )
        self.setup, self.rng = RaceSetup(track, config, (CORRECTED, CORRECTED)), rng
        self.vehicles = vehicle_rows(self.setup.vehicles, 1)[0]
        self.state, self.shares = self.start(races), self.draw_shares(races)
        # They end at different times, so that a batch holds all parts of a race.
        self.end = rng.integers(100, self.setup.settings.end_tick, races)

    def start(self, races: int):
        """Put the cars of some races on the grid."""
        starts = Starts(
            self.rng.uniform(0.0, self.setup.track.length, races), self.rng.integers(0, 2, races)
        )
        return start_races(
            self.setup, starts, self.rng.integers(2**63, size=races, dtype=np.uint64)
        )

    def draw_shares(self, races: int) -> np.ndarray:
        """The share of its speed that each car drives at, shape (races, 2): half of them are
        slower, to be passed.
        """
        return np.where(
            self.rng.uniform(size=(races, 2)) < 0.5, 1.0, self.rng.uniform(0.4, 1.0, (races, 2))
        )

    def observe(self) -> np.ndarray:
        """What each car sees, shape (races, 2, SEEN)."""
        out = np.empty((self.state.races, 2, SEEN))
        _observe_all(self.setup.track.arrays, self.state, self.vehicles, self.setup.settings, out)
        return out

    def step(self, corrections: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Drive on; returns rewards (races, 2), and which races ended by a crash, and by their
        time.
        """
        before = self.state.progress.copy()
        theta = np.concatenate([corrections, self.shares[:, :, None]], axis=2)
        advance(self.setup, self.state, theta, STEP, threads=1, ittc=False)
        gained = self.state.progress - before
        reward = PROGRESS * gained + GAIN * (gained - gained[:, ::-1]) - FAULT * self.state.fault
        crashed = self.state.crashed
        return reward, crashed, ~crashed & (self.state.tick >= self.end)

    def begin_anew(self, ended: np.ndarray) -> None:
        """Start the races that ended again."""
        for values, fresh in zip(self.state, self.start(int(ended.sum())), strict=True):
            values[ended] = fresh
        self.shares[ended] = self.draw_shares(int(ended.sum()))
        self.end[ended] = self.setup.settings.end_tick


class ResidualVecEnv(VecEnv):
    """All cars of all races as environments; an action is a correction before its tanh."""

    def __init__(self, tracks: list[Track], races: int, rng: np.random.Generator) -> None:
        gaps, self.render_mode = (2.5, 50.0), None
        self.groups = [
            Races(track, races, min(gaps[i % 2], 0.4 * track.length), rng)
            for i, track in enumerate(tracks)
        ]
        box = [spaces.Box(-5.0, 5.0, (size,), np.float32) for size in (SEEN, 2)]
        super().__init__(2 * races * len(tracks), *box)

    def reset(self) -> np.ndarray:
        """What all cars see."""
        return np.concatenate([group.observe().reshape(-1, SEEN) for group in self.groups]).astype(
            np.float32
        )

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions."""
        self.actions = np.tanh(actions.astype(np.float64))

    def step_wait(self):
        """Drive on, and begin the races anew that end."""
        found, infos = [], []
        size = 2 * self.groups[0].state.races
        for i, group in enumerate(self.groups):
            reward, crashed, timed_out = group.step(
                self.actions[i * size : (i + 1) * size].reshape(-1, 2, 2)
            )
            seen = group.observe()
            ended = crashed | timed_out
            for race, car in np.ndindex(len(seen), 2):
                last = {"terminal_observation": seen[race, car].astype(np.float32)}
                infos.append(
                    last | {"TimeLimit.truncated": bool(timed_out[race])} if ended[race] else {}
                )
            if ended.any():
                group.begin_anew(ended)
                seen[ended] = group.observe()[ended]
            found.append((seen.reshape(-1, SEEN), reward.ravel(), np.repeat(ended, 2)))
        seen, reward, ended = (np.concatenate(values) for values in zip(*found, strict=True))
        return seen.astype(np.float32), reward.astype(np.float32), ended, infos

    def close(self) -> None:
        """Nothing is open."""

    def get_attr(self, name, indices=None):
        """Attributes, the same for all environments."""
        return [getattr(self, name)] * self.num_envs

    def set_attr(self, name, value, indices=None) -> None:
        """Not used."""
        raise NotImplementedError

    def env_method(self, name, *arguments, indices=None, **options):
        """Not used."""
        raise NotImplementedError

    def env_is_wrapped(self, wrapper, indices=None) -> list[bool]:
        """No environment is wrapped."""
        return [False] * self.num_envs


def actor_layers(model: PPO) -> list[tuple[np.ndarray, np.ndarray]]:
    """Weights and biases of the network of the actions."""
    layers = [
        one for one in model.policy.mlp_extractor.policy_net if isinstance(one, torch.nn.Linear)
    ]
    return [
        (one.weight.detach().numpy().copy(), one.bias.detach().numpy().copy())
        for one in [*layers, model.policy.action_net]
    ]


def crashes_alone(track: Track, planner: Planner, races: int, seconds: float) -> float:
    """Return the share of cars alone that crash in 40 s.

    The parameters are the defaults, noise and speeds those of `contest`.
    """
    gap = min(0.5 * track.length, 50.0)
    config = RaceConfig(
        start="staggered",
        start_gap=gap,
        start_spacing=0.0,
        steering_noise=CONTEST.steering_noise,
        duration=seconds,
        speed_range=calibration_of(track, CONTEST).speed_range,
    )
    starts = Starts(np.arange(races) / races * track.length, np.zeros(races, np.int64))
    state = run_races(
        track, [planner.policy()] * races, planner.policy(), config, starts=starts, threads=1
    ).state
    return float(1.0 - np.exp(-40.0 * (state.crash == 1).sum() / (0.02 * state.tick.sum())))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the driver")
    parser.add_argument(
        "--hold-out",
        nargs="*",
        default=["Saltmere", "Vellindra"],
        help="circuits left out of training",
    )
    parser.add_argument("--tracks", nargs="*", default=list_tracks(), help="circuits")
    parser.add_argument("--random", type=int, default=18, help="random circuits, beside the others")
    parser.add_argument("--races", type=int, default=11, help="races at a time on a circuit")
    parser.add_argument("--steps", type=int, default=5_000_000, help="steps of training")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rng = np.random.default_rng(arguments.seed)
    tracks = [load_track(name) for name in arguments.tracks if name not in arguments.hold_out]
    tracks += [random_circuit(RandomCircuits(), number) for number in range(arguments.random)]
    env = ResidualVecEnv(tracks, arguments.races, rng)
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=32,
        batch_size=8448,  # two batches of 528 cars
        n_epochs=4,
        gamma=0.98,
        gae_lambda=0.95,
        clip_range=0.2,
        learning_rate=lambda left: 8e-4 * left + 2e-5,
        seed=arguments.seed,
        device="cpu",
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.2},
        verbose=1,
    )
    model.learn(arguments.steps)
    about = {key: getattr(arguments, key) for key in ("random", "races", "steps", "seed")}
    about["held_out"] = ", ".join(arguments.hold_out)
    folder = save_lidar_planner(
        arguments.out, "residual", actor_layers(model), name="residual", training=about
    )
    planner = load_lidar_planner(folder)
    for track in [load_track(name) for name in arguments.tracks]:
        crashes = crashes_alone(track, planner, 20, 40.0)
        note = ", held out" if track.name in arguments.hold_out else ""
        print(f"{track.name}: own crashes alone in 40 s {crashes:.3f}{note}", flush=True)


if __name__ == "__main__":
    main()
