"""Control-level task: batches of races with the inputs and outputs of a network planner.

The observation is :data:`pcs_racing.planners.network.INPUTS`, computed by the planner's own code.
An action is the output of the network's last layer before its ``tanh``; the ``tanh`` gives a
steering angle and a speed here and in the planner. The mean of a Gaussian policy with tanh layers
therefore *is* a network planner.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from pcs_racing.base.compilation import kernel
from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import InputError
from pcs_racing.envs.batch import BatchStep
from pcs_racing.envs.drive_batch import DriveBatch
from pcs_racing.envs.drive_options import DriveOptions
from pcs_racing.envs.vector import BatchVectorEnv
from pcs_racing.planners.network import (
    INPUTS,
    TOP_SPEED,
    WEIGHT_LIMIT,
    network_inputs,
    network_planner,
)
from pcs_racing.planners.planner import Planner, Policy
from pcs_racing.planners.registry import parse_policy
from pcs_racing.planners.trained import save_trained
from pcs_racing.planners.view import VIEW_SIZE
from pcs_racing.race.config import DT, RaceConfig, load_race_config
from pcs_racing.race.kernel import fill_view
from pcs_racing.race.races import RaceSetup, run_races
from pcs_racing.race.state import take
from pcs_racing.track.loading import load_track
from pcs_racing.track.track import Track
from pcs_racing_agents.learning.ppo.evaluation import Matchup, MatchupScore, score_races
from pcs_racing_agents.learning.ppo.settings import DriveSettings

ACTION_LIMIT = 10.0  # tanh(ACTION_LIMIT) is 1 - 4e-9
EVALUATION_SEED = 1_000_003  # root seed of the evaluation races


@kernel
def _observe(track, state, vehicles, settings, rows, view, inputs, out):
    """Write the network inputs of car 0 of the races ``rows`` into the same rows of ``out``."""
    for race in rows:
        fill_view(track, state, race, 0, vehicles[race], settings, view)
        network_inputs(track, view, inputs)
        for k in range(inputs.shape[0]):
            out[race, k] = inputs[k]


class LearnerBatch(DriveBatch):
    """Batch of races with network-planner inputs as observations and pre-``tanh`` actions."""

    def __init__(self, episodes: int, options: DriveOptions, **more: Any) -> None:
        super().__init__(episodes, options, **more)
        self.observation_space = spaces.Box(-np.inf, np.inf, (len(INPUTS),), np.float32)
        self.action_space = spaces.Box(-ACTION_LIMIT, ACTION_LIMIT, (2,), np.float32)
        self._view_buffers = np.empty(VIEW_SIZE), np.empty(len(INPUTS))

    def check_actions(self, actions: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """Return steering and speed in [-1, 1] from the outputs of a network's last layer."""
        return np.tanh(super().check_actions(actions, shape))

    def step(
        self, actions: NDArray[np.float64], generators: Sequence[np.random.Generator] = ()
    ) -> BatchStep:
        """Advance every race by one step."""
        observations = np.empty((self.episodes, len(INPUTS)), np.float32)
        result = super().step(actions, generators)
        self.observe(self._rows, observations)
        return result._replace(observations=observations)

    def observe(self, rows: NDArray[np.int64], out: NDArray[np.float32]) -> None:
        """Write the network inputs of some races into the same rows of ``out``."""
        settings = self.setup.settings
        state, _, vehicles = self.races
        _observe(self.track.arrays, state, vehicles, settings, rows, *self._view_buffers, out)


class LearnerEnv(BatchVectorEnv):
    """Control-level environment with network-planner inputs and outputs; car 0 is the learner."""

    batch_type = LearnerBatch
    batch: LearnerBatch
    options_type = DriveOptions


@dataclass(frozen=True, eq=False)
class DriveTask:
    """Learning task at the control level, made by :func:`make_drive_task`."""

    settings: DriveSettings
    tracks: tuple[Track, ...]
    rules: tuple[RaceConfig, ...]
    opponents: Mapping[str, Policy]  #: Opponents by the names of the settings.

    activation = "tanh"
    limit = WEIGHT_LIMIT
    unit = "steps"
    threads = 1
    default_name = "ppo-drive"

    @property
    def identity(self) -> dict[str, Any]:
        """Inputs of the results in addition to the settings: content hashes of the tracks."""
        return {"tracks_sha256": {track.name: track.content_hash for track in self.tracks}}

    def env_groups(self) -> list[LearnerEnv]:
        """Make the training environments: a group for each track and rules."""
        settings = self.settings
        opponents = [(weight, self.opponents[name]) for name, weight in settings.opponents.items()]
        return [
            LearnerEnv(
                settings.envs,
                track=track,
                race=self.learning_rules(track, config),
                opponent=opponents,
                top_speed=TOP_SPEED,
                look_ahead=(0.0,),
                time_step=DT * settings.hold,
                rivalry=settings.rivalry,
                crash_penalty=settings.crash_penalty,
                autoreset_mode=AutoresetMode.SAME_STEP,
                threads=1,
            )
            for track in self.tracks
            for config in self.rules
        ]

    def learning_rules(self, track: Track, config: RaceConfig) -> RaceConfig:
        """Return the rules with the duration and the slow opponents used in training."""
        changes: dict[str, Any] = {"duration": self.settings.duration}
        if self.settings.slowest > 0.0:
            high = RaceSetup(track, config, (_learner_planner((), 2),) * 2).speed_range[1]
            changes["speed_range"] = (self.settings.slowest, high)
        return replace(config, **changes)

    def evaluate(self, layers: DenseLayers) -> dict[Matchup, MatchupScore]:
        """Race a policy as a planner, without exploration noise, under the unchanged rules."""
        planner = _learner_planner(layers.hidden, self.settings.hold)
        policy = planner.policy(layers.flat(), name="learner")
        # An even number, since every start line is raced from both sides.
        races = 2 * max(1, self.settings.evaluation_races // (2 * len(self.opponents)))
        opponents = [opponent for opponent in self.opponents.values() for _ in range(races)]
        scores = {}
        for track in self.tracks:
            for config in self.rules:
                result = run_races(
                    track, policy, opponents, config, seed=EVALUATION_SEED, threads=1
                )
                winner, blamed = result.winner, result.own_crash[:, 0]
                payoffs = np.where(winner == 0, 1.0, np.where((winner == 1) | blamed, -1.0, 0.0))
                for k, name in enumerate(self.opponents):
                    rows = np.arange(k * races, (k + 1) * races)
                    scores[Matchup(track.name, config.name, name)] = score_races(
                        payoffs[rows], winner[rows], take(result.state, rows)
                    )
        return scores

    def save(self, layers: DenseLayers, folder: Path, name: str, about: Mapping[str, Any]) -> Path:
        """Write a policy as the files of a network planner."""
        return save_trained(folder, layers, name=name, hold=self.settings.hold, training=about)


@cache
def _learner_planner(hidden: tuple[int, ...], hold: int) -> Planner:
    """Return the planner of a network in training; weights are parameters, so it compiles once."""
    return network_planner("learner", hidden, hold=hold)


def make_drive_task(settings: DriveSettings) -> DriveTask:
    """Load tracks, rules and opponents, and check their consistency."""
    tracks = tuple(load_track(name) for name in settings.tracks)
    rules = tuple(load_race_config(race) for race in settings.races)
    if len({config.name for config in rules}) < len(rules):
        raise InputError(f"races is {list(settings.races)}; two of these rules have the same name")
    return DriveTask(
        settings, tracks, rules, {name: parse_policy(name) for name in settings.opponents}
    )
