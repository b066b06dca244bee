"""Many races driven by one learner that sees what a network planner sees, and acts as its last layer does.

The observation is :data:`pcs_racing.planners.network.INPUTS`, computed by the code of the planner itself. An
action is what the network's output layer puts out before its ``tanh``; here and in the planner ``tanh`` makes it a
steering angle and a speed. The mean of a Gaussian policy with tanh layers therefore *is* a network planner.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import NDArray

from pcs_racing.base.compilation import kernel
from pcs_racing.base.dense import DenseLayers
from pcs_racing.base.errors import InputError
from pcs_racing.envs.drive_batch import DriveBatch, DriveOptions
from pcs_racing.planners.network import INPUTS, TOP_SPEED, WEIGHT_LIMIT, network_inputs, network_planner
from pcs_racing.planners.planner import VIEW_SIZE, Planner, Policy
from pcs_racing.planners.registry import parse_policy
from pcs_racing.planners.trained import save_driver
from pcs_racing.race.config import RaceConfig, load_race_config
from pcs_racing.race.kernel import fill_view
from pcs_racing.race.races import RaceSetup, run_races
from pcs_racing.race.state import RaceState, take
from pcs_racing.track.track import Track, load_track
from pcs_racing_agents.learning.ppo.evaluation import Matchup, Score, score_races
from pcs_racing_agents.learning.ppo.settings import DriveSettings
from pcs_racing_agents.learning.ppo.tasks import GroupStep, split_envs

__all__ = ["ACTION_LIMIT", "DriveTask", "Drives", "DrivesState", "make_drive_task"]

ACTION_LIMIT = 10.0  # tanh of it is 1 but for 4e-9
EVALUATION_SEED = 1_000_003  # root of the races of evaluations


class DrivesState(NamedTuple):
    """A moment of :class:`Drives`."""

    races: RaceState
    opponents: NDArray[np.int64]
    generators: list[dict[str, Any]]


@kernel
def _observe(track, state, vehicles, settings, rows, view, inputs, out):  # type: ignore[no-untyped-def]
    """Write the inputs of a network in car 0 of the races ``rows`` into their rows of ``out``."""
    for race in rows:
        fill_view(track, state, race, 0, vehicles[race], settings, view)
        network_inputs(track, view, inputs)
        for k in range(inputs.shape[0]):
            out[race, k] = inputs[k]


class Drives:
    """Races on one circuit against policies of one planner; car 0 belongs to the learner.

    Race ``i`` has its own generator and begins anew in the step in which it ends.

    Parameters
    ----------
    races : int
    track : Track
    config : RaceConfig
    opponents : sequence of Policy
        One of them is drawn for each race.
    hold : int
        Simulation steps of 0.01 s for which an action holds; even.
    rivalry : float
        Share of the opponent's progress that is taken off the own one.
    leading : float
        What a second in front is worth, m.
    crash_penalty : float
        What a crash by own fault costs, m.
    """

    def __init__(
        self,
        races: int,
        track: Track,
        config: RaceConfig,
        opponents: Sequence[Policy],
        *,
        hold: int = 2,
        rivalry: float = 0.5,
        leading: float = 0.0,
        crash_penalty: float = 10.0,
    ) -> None:
        options = DriveOptions(
            track=track,
            opponent=list(opponents),
            race=config,
            time_step=0.01 * hold,
            top_speed=TOP_SPEED,
            look_ahead=(0.0,),
            rivalry=rivalry,
            crash_penalty=crash_penalty,
        )
        self.batch = DriveBatch(races, options, threads=1)
        self.observation_space: spaces.Box[Any] = spaces.Box(-np.inf, np.inf, (len(INPUTS),), np.float32)
        self.action_space: spaces.Space[Any] = spaces.Box(-ACTION_LIMIT, ACTION_LIMIT, (2,), np.float32)
        self._leading = leading * options.time_step
        self._rngs: list[np.random.Generator] = []
        self._rows = np.arange(races)
        self._buffers = np.empty(VIEW_SIZE), np.empty(len(INPUTS))

    def __len__(self) -> int:
        return self.batch.races

    def reset(self, seed: int) -> NDArray[np.float32]:
        """Begin every race, race ``i`` with seed ``seed + i``."""
        self._rngs = [seeding.np_random(seed + i)[0] for i in range(len(self))]
        self.batch.restart(self._rows, self._rngs)
        return self._observe(self._rows, np.empty((len(self), len(INPUTS)), np.float32))

    def step(self, actions: NDArray[Any]) -> GroupStep:
        """Drive every race one step on; ``actions`` has shape (n, 2)."""
        _, rewards, terminated, truncated = self.batch.step(np.tanh(actions.astype(np.float64)))
        rewards += self._leading * (self.batch.state.lead > 0.0)
        seen = self._observe(self._rows, np.empty((len(self), len(INPUTS)), np.float32))
        last = seen
        over = np.flatnonzero(terminated | truncated)
        if len(over):
            last = seen.copy()
            self.batch.restart(over, [self._rngs[i] for i in over])
            self._observe(over, seen)
        return GroupStep(seen, rewards, terminated, truncated, last)

    def _observe(self, rows: NDArray[np.int64], out: NDArray[np.float32]) -> NDArray[np.float32]:
        batch = self.batch
        _observe(batch.track.arrays, batch.state, batch.vehicles, batch.setup.settings, rows, *self._buffers, out)
        return out

    def get_state(self) -> DrivesState:
        """Return all that the rest of the races, and all later ones, depend on."""
        return DrivesState(*self.batch.get_state(), [dict(rng.bit_generator.state) for rng in self._rngs])

    def set_state(self, state: DrivesState) -> None:
        """Go on from what `get_state` returned, here or in equal races."""
        self.batch.set_state(state.races, state.opponents)
        for rng, given in zip(self._rngs, state.generators, strict=True):
            rng.bit_generator.state = given


@dataclass(frozen=True, eq=False)
class DriveTask:
    """Races to learn driving from; made by :func:`make_drive_task`.

    Attributes
    ----------
    settings : DriveSettings
    tracks : tuple of Track
    rules : tuple of RaceConfig
    policies : tuple of Policy
        The opponents, in the order of the settings.
    """

    settings: DriveSettings
    tracks: tuple[Track, ...]
    rules: tuple[RaceConfig, ...]
    policies: tuple[Policy, ...]

    activation = "tanh"
    limit = WEIGHT_LIMIT
    unit = "steps"
    default_name = "ppo-drive"

    @property
    def identity(self) -> dict[str, Any]:
        """What the results depend on beside the settings."""
        return {"tracks_sha256": {track.name: track.content_hash for track in self.tracks}}

    def env_groups(self) -> list[Drives]:
        """Make the environments to learn from: for each circuit, rules and planner of opponents."""
        settings = self.settings
        by_planner: dict[str, list[Policy]] = {}
        for policy, weight in zip(self.policies, settings.opponents.values(), strict=True):
            by_planner.setdefault(policy.planner.name, []).extend([policy] * weight)
        shares = split_envs(settings.envs, [len(policies) for policies in by_planner.values()])
        return [
            Drives(
                share,
                track,
                self.learning_rules(track, config),
                policies,
                hold=settings.hold,
                rivalry=settings.rivalry,
                leading=settings.leading,
                crash_penalty=settings.crash_penalty,
            )
            for track in self.tracks
            for config in self.rules
            for share, policies in zip(shares, by_planner.values(), strict=True)
        ]

    def learning_rules(self, track: Track, config: RaceConfig) -> RaceConfig:
        """The rules with the duration and the slow opponents of learning."""
        changes: dict[str, Any] = {"duration": self.settings.duration}
        if self.settings.slowest > 0.0:
            high = RaceSetup(track, config, (_learner_planner((), 2),) * 2).speed_range[1]
            changes["speed_range"] = (self.settings.slowest, high)
        return replace(config, **changes)

    def evaluate(self, layers: DenseLayers) -> dict[Matchup, Score]:
        """Race as the planner that a policy becomes does, without exploring, under the unchanged rules."""
        policy = _learner_planner(layers.hidden, self.settings.hold).policy(layers.flat(), name="learner")
        names = list(self.settings.opponents)
        each = 2 * max(1, self.settings.evaluation_races // (2 * len(names)))
        opponents = [opponent for opponent in self.policies for _ in range(each)]
        scores = {}
        for track in self.tracks:
            for config in self.rules:
                result = run_races(track, policy, opponents, config, seed=EVALUATION_SEED, threads=1)
                winner, blamed = result.winner, result.own_crash[:, 0]
                worth = np.where(winner == 0, 1.0, np.where((winner == 1) | blamed, -1.0, 0.0))
                for k, name in enumerate(names):
                    rows = np.arange(k * each, (k + 1) * each)
                    scores[Matchup(track.name, config.name, name)] = score_races(
                        worth[rows], winner[rows], take(result.state, rows)
                    )
        return scores

    def save(self, layers: DenseLayers, folder: Path, name: str, about: Mapping[str, Any]) -> Path:
        """Write a policy as a driver."""
        return save_driver(folder, layers, name=name, hold=self.settings.hold, training=about)


@cache
def _learner_planner(hidden: tuple[int, ...], hold: int) -> Planner:
    """The planner of a network that still learns: its weights are parameters, so that it is compiled once."""
    return network_planner("learner", hidden, hold=hold)


def make_drive_task(settings: DriveSettings) -> DriveTask:
    """Load what settings name, and check that it fits together.

    Raises
    ------
    InputError
        If a circuit, rules or an opponent is unknown, or they do not fit.
    """
    tracks = tuple(load_track(name) for name in settings.tracks)
    rules = tuple(load_race_config(race) for race in settings.races)
    if len({config.name for config in rules}) < len(rules):
        raise InputError(f"races is {list(settings.races)}; two of these rules have the same name")
    policies = tuple(parse_policy(name) for name in settings.opponents)
    return DriveTask(settings, tracks, rules, policies)
