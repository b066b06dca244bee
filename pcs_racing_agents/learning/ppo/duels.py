"""Strategy-level task: games of moves against a mixture of opponents."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode

from pcs_racing.base.dense import DenseLayers
from pcs_racing.envs.duel import DuelVectorEnv
from pcs_racing.envs.game_batch import GameBatch, GameOptions
from pcs_racing.envs.opponents import read_opponents
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.config import GameConfig, load_game_config
from pcs_racing.game.identity import game_identity
from pcs_racing.game.make import make_game
from pcs_racing.game.rules import RaceGame
from pcs_racing.track.loading import load_track
from pcs_racing.track.track import Track
from pcs_racing_agents.learning.ppo.evaluation import Matchup, MatchupScore, score_races
from pcs_racing_agents.learning.ppo.learner import group_seeds
from pcs_racing_agents.learning.ppo.settings import DuelSettings
from pcs_racing_agents.networks.network import RegretNetwork
from pcs_racing_agents.networks.network_files import save_network


def planner_groups(
    envs: int, opponents: Mapping[str, int], planners: Mapping[str, str]
) -> list[tuple[int, list[tuple[int, str]]]]:
    """Group opponents by planner: a number of environments, and weights and names of opponents.

    The opponents of a batch of games share a planner. The numbers of environments are in proportion
    to the weights, at least 1.

    Parameters
    ----------
    opponents, planners : Mapping
        Weight of each opponent, and the name of its planner.
    """
    groups: dict[str, list[tuple[int, str]]] = {}
    for name, weight in opponents.items():
        groups.setdefault(planners[name], []).append((weight, name))
    weights = [sum(weight for weight, _ in group) for group in groups.values()]
    edges = np.cumsum([0, *weights]) * envs / sum(weights)
    shares = [max(1, round(high) - round(low)) for low, high in pairwise(edges)]
    return list(zip(shares, groups.values(), strict=True))


@dataclass(frozen=True, eq=False)
class DuelTask:
    """Learning task at the strategy level, made by :func:`make_duel_task`."""

    settings: DuelSettings
    archive: PolicyArchive
    tracks: tuple[Track, ...]
    game: RaceGame  #: Game on the first track; archive, moves and observations are always the same.
    batches: Mapping[Matchup, GameBatch] = field(repr=False)  #: Games of the evaluation.
    overrides: Mapping[str, Any]  #: Rules that replace the settings' rules; plain values by name.
    threads: int  #: Threads that simulate the training games; no effect on the results.

    activation = "relu"
    limit = 1e6
    unit = "moves"

    @property
    def identity(self) -> dict[str, Any]:
        """Inputs of the results in addition to the settings: content hashes and replaced rules."""
        tracks = {track.name: track.content_hash for track in self.tracks}
        return {
            "archive_sha256": self.archive.content_hash,
            "tracks_sha256": tracks,
            **self.overrides,
        }

    def env_groups(self) -> list[DuelVectorEnv]:
        """Make the training environments: a group for each track and opponent planner."""
        opponents = self.settings.opponents
        planners = {
            name: (read_opponents(name, self.game)[0].planner or self.archive.family()).name
            for name in opponents
        }
        groups = planner_groups(self.settings.envs, opponents, planners)
        return [
            DuelVectorEnv(
                share,
                track=track,
                archive=self.archive,
                rules=self.game.config,
                opponent=group,
                autoreset_mode=AutoresetMode.SAME_STEP,
                threads=max(1, self.threads // (len(self.tracks) * len(groups))),
            )
            for track in self.tracks
            for share, group in groups
        ]

    def network(
        self, layers: DenseLayers, name: str, about: Mapping[str, Any] | None = None
    ) -> RegretNetwork:
        """Return a policy as a network with the logits of the moves as values."""
        size = len(self.game.observation_elements)
        return RegretNetwork(
            name=name,
            identity=game_identity(self.game),
            target="ppo",
            clipped=False,
            layers=layers,
            mean=np.zeros(size, np.float32),
            scale=np.ones(size, np.float32),
            training=dict(about or {}),
        )

    def evaluate(self, layers: DenseLayers) -> dict[Matchup, MatchupScore]:
        """Play the evaluation games with the most probable moves, and return their scores."""
        network = self.network(layers, "learner")
        seeds = group_seeds(0, len(self.batches), 1)
        with ThreadPoolExecutor(self.threads) as pool:
            scores = pool.map(play_duels, self.batches.values(), [network] * len(seeds), seeds)
            return dict(zip(self.batches, scores, strict=True))

    def save(self, layers: DenseLayers, folder: Path, name: str, about: Mapping[str, Any]) -> Path:
        """Write a policy as a network."""
        return save_network(self.network(layers, name, about), folder)

    @property
    def default_name(self) -> str:
        """Default name of the policy, also the name of the shipped network of agent ``ppo``."""
        return f"{self.archive.name}-{self.game.config.race.name}-ppo"


def make_duel_task(
    settings: DuelSettings, archive: PolicyArchive | None, rules: GameConfig | None, threads: int
) -> DuelTask:
    """Load tracks, archive, rules and opponents, and check their consistency.

    Parameters
    ----------
    archive : PolicyArchive, optional
        Archive that replaces the settings' archive.
    rules : GameConfig, optional
        Rules that replace the race and the size of moves of the settings.
    threads : int
        Threads that simulate the games; no effect on the results.
    """
    overrides = {} if rules is None else {"game": asdict(rules)}
    archive = load_archive(settings.archive) if archive is None else archive
    rules = load_game_config(settings.rules, epsilon=settings.epsilon) if rules is None else rules
    tracks = tuple(load_track(name) for name in settings.tracks)
    games = [make_game(track, archive, rules) for track in tracks]
    each = max(2, settings.evaluation_races // len(settings.opponents))
    batches = {
        Matchup(track.name, rules.race.name, name): GameBatch(
            each, GameOptions(track=track, archive=archive, rules=rules, opponent=name), threads=1
        )
        for track in tracks
        for name in settings.opponents
    }
    return DuelTask(settings, archive, tracks, games[0], batches, overrides, threads)


def play_duels(batch: GameBatch, network: RegretNetwork, seed: int) -> MatchupScore:
    """Play a batch of games in place with a network's most probable moves, and return the score."""
    # With equal seeds, starts, policies and noise are equal for all networks: evaluations are
    # comparable.
    rngs = [seeding.np_random(seed + i)[0] for i in range(batch.episodes)]
    batch.restart(np.arange(batch.episodes), rngs)
    payoffs = np.zeros(batch.episodes)
    for _ in range(batch.game.config.moves):
        payoffs = batch.step(network.choose(batch.seen[:, 0])[:, None], rngs).rewards
    state = batch.started()
    return score_races(payoffs, batch.game.winner(state), state.race)
