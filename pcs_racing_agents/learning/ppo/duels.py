"""The level of strategy: games of moves against a mixture of opponents, to learn from and to judge by."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from pcs_racing.envs.duel import DuelVectorEnv
from pcs_racing.envs.game_batch import GameBatch
from pcs_racing.envs.opponents import parse_opponents
from pcs_racing.game.archive import PolicyArchive, load_archive
from pcs_racing.game.config import GameConfig, load_game_config
from pcs_racing.game.rules import RaceGame, make_game
from pcs_racing.track.track import Track, load_track
from pcs_racing_agents.learning.ppo.parts import part_seeds, split_envs
from pcs_racing_agents.learning.ppo.scores import Cell, Score, score_of
from pcs_racing_agents.learning.ppo.settings import DuelSettings
from pcs_racing_agents.networks.layers import Layers
from pcs_racing_agents.networks.network import RegretNetwork, game_identity

__all__ = ["DuelLevel", "duel_level", "play_duels"]

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class DuelLevel:
    """Games to learn strategy from; made by :func:`duel_level`.

    Attributes
    ----------
    settings : DuelSettings
    archive : PolicyArchive
    tracks : tuple of Track
    game : RaceGame
        On the first circuit; archive, moves and observations are the same on all.
    mixtures : tuple of tuple of (weight, name)
        The opponents, those apart that drive with different planners.
    cells : mapping of Cell to GameBatch
        Games to judge by.
    given : mapping
        Rules that were given beside the settings, as plain values by name.
    """

    settings: DuelSettings
    archive: PolicyArchive
    tracks: tuple[Track, ...]
    game: RaceGame
    mixtures: tuple[tuple[tuple[int, str], ...], ...]
    cells: Mapping[Cell, GameBatch] = field(repr=False)
    given: Mapping[str, Any] = field(default_factory=dict)

    activation = "relu"
    limit = 1e6
    unit = "moves"

    @property
    def identity(self) -> dict[str, Any]:
        """What the results depend on beside the settings."""
        tracks = {track.name: track.content_hash for track in self.tracks}
        return {"archive_sha256": self.archive.content_hash, "tracks_sha256": tracks, **self.given}

    def parts(self) -> list[DuelVectorEnv]:
        """Make the environments to learn from."""
        shares = split_envs(self.settings.envs, [sum(weight for weight, _ in mixture) for mixture in self.mixtures])
        return [
            DuelVectorEnv(
                share,
                track=track,
                archive=self.archive,
                race=self.game.config,
                opponent=list(mixture),
                autoreset_mode=AutoresetMode.SAME_STEP,
                threads=1,
            )
            for track in self.tracks
            for share, mixture in zip(shares, self.mixtures, strict=True)
        ]

    def network(self, layers: Layers, name: str, about: Mapping[str, Any] | None = None) -> RegretNetwork:
        """Return a policy as a network that any agent can ask; its values are the logits of the moves."""
        size = len(self.game.observation_elements)
        return RegretNetwork(
            name=name,
            identity=game_identity(self.game),
            target="ppo",
            clipped=False,
            weights=layers.weights,
            biases=layers.biases,
            mean=np.zeros(size, np.float32),
            scale=np.ones(size, np.float32),
            training=dict(about or {}),
        )

    def judge(self, layers: Layers) -> dict[Cell, Score]:
        """Play the games to judge by, always making the most likely move."""
        network = self.network(layers, "learner")
        seeds = part_seeds(0, len(self.cells), 1)
        return {
            cell: play_duels(batch, network, seed)
            for (cell, batch), seed in zip(self.cells.items(), seeds, strict=True)
        }

    def save(self, layers: Layers, folder: Path, name: str, about: Mapping[str, Any]) -> Path:
        """Write a policy as a network."""
        return self.network(layers, name, about).save(folder)

    @property
    def default_name(self) -> str:
        """The name under which the agent ``ppo`` looks for a shipped network."""
        return f"{self.archive.name}-{self.game.config.race.name}-ppo"


def duel_level(
    settings: DuelSettings, archive: PolicyArchive | None = None, rules: GameConfig | None = None
) -> DuelLevel:
    """Load what settings name, and check that it fits together.

    Parameters
    ----------
    settings : DuelSettings
    archive : PolicyArchive, optional
        In place of the one that the settings name.
    rules : GameConfig, optional
        In place of the race and the size of moves that the settings name.

    Raises
    ------
    InputError
        If a circuit, the archive, the rules or an opponent is unknown, or they do not fit.
    """
    given = {} if rules is None else {"game": asdict(rules)}
    archive = load_archive(settings.archive) if archive is None else archive
    tracks = tuple(load_track(name) for name in settings.tracks)
    rules = load_game_config(settings.race, epsilon=settings.epsilon) if rules is None else rules
    games = [make_game(track, archive, rules) for track in tracks]
    by_planner: dict[str, list[tuple[int, str]]] = {}
    for name, weight in settings.opponents.items():
        planner = parse_opponents(name, games[0])[0].planner or archive.family()
        by_planner.setdefault(planner.name, []).append((weight, name))
    each = max(2, settings.evaluation_races // len(settings.opponents))
    cells = {
        Cell(track.name, games[0].config.race.name, name): GameBatch(
            each, track=track, archive=archive, race=rules, opponent=name, threads=1
        )
        for track in tracks
        for name in settings.opponents
    }
    mixtures = tuple(tuple(mixture) for mixture in by_planner.values())
    return DuelLevel(settings, archive, tracks, games[0], mixtures, cells, given)


def play_duels(batch: GameBatch, network: RegretNetwork, seed: int) -> Score:
    """Let a network play a game everywhere in a batch, always its most likely move, and count what came of it.

    Parameters
    ----------
    batch : GameBatch
        Overwritten.
    network : RegretNetwork
    seed : int
        Root of starts, policies and noise: the same seed gives every network the same games.
    """
    rngs = [seeding.np_random(seed + i)[0] for i in range(batch.episodes)]
    batch.restart(np.arange(batch.episodes), rngs)
    worth = np.zeros(batch.episodes)
    for _ in range(batch.game.config.moves):
        worth = batch.step(network.choose(batch.seen[:, 0])[:, None], rngs).rewards
    state = batch.started()
    return score_of(worth, batch.game.winner(state), state.race)
