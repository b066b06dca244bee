"""Estimates of the running time of long commands: the amount of work times measured rates.

    python benchmarks/command_rates.py

measures all rates below and prints them in this order. Apart from one share they are processor seconds on a free AMD
EPYC, and more where other work shares its caches. Compilation is not included.
"""

import argparse
import sys
from dataclasses import replace

from pcs_racing.game.config import GameConfig
from pcs_racing.race.driving import default_threads
from pcs_racing_agents.learning.ppo.settings import DuelSettings, PPOSettings
from pcs_racing_agents.learning.responses.learner import ResponseSettings, load_response_settings
from pcs_racing_agents.learning.robust import (
    PSROSettings,
    RobustSettings,
    load_psro_settings,
    load_robust_settings,
)
from pcs_racing_agents.learning.self_play import SelfPlaySettings, load_self_play_settings
from pcs_racing_agents.networks.settings import TrainSettings
from pcs_racing_agents.study.config import StudyConfig
from pcs_racing_agents.synthesis.config import ArchiveConfig

RACING = 6.4e-5
"""Processor seconds for a second of a race between two cars of the lattice planner."""
SHARED = 0.45
"""Share of the races of several agents from the same starts that is driven: what they have in common, only once."""
TREE_SEGMENT = 1.0e-4
"""For a step of 8 s of a game tree, counting every joint history once (most of them need not be driven)."""
EGO_SEGMENT = 3.0e-4
"""For a step of 8 s of an ego tree, likewise."""
DUEL_MOVE = 1.1e-3
"""For a move that PPO learns from, its evaluations included."""
DRIVE_STEP = 4.2e-5
"""For a step of driving that PPO learns from, its evaluations included."""
ROW = 2.2e-6
"""For a row that a network of two layers of 64 learns from, once."""

AXES_MOVES = 4
"""Moves of an archive of two characteristics, "stay" not counted."""
BLIND_ROUNDS = 3
LEAD_PLAN_ROUNDS = 2
"""Assumed rounds of the search for the best open-loop sequence."""
LONG = 60.0
"""Least duration of work, s, that a command announces."""


def duration_text(seconds: float) -> str:
    """Return a duration as text: ``"40 s"``, ``"5 min"``, ``"2.5 h"``."""
    if seconds < 60.0:
        return f"{seconds:.0f} s"
    if seconds < 90.0 * 60.0:
        return f"{seconds / 60.0:.0f} min"
    hours = seconds / 3600.0
    return f"{hours:.1f} h" if hours < 10.0 else f"{hours:.0f} h"


def cores_of(arguments: argparse.Namespace) -> int | None:
    """Return the number of cores that the options of an executor use; None for a cluster on other machines."""
    if arguments.scheduler is not None:
        return None
    return arguments.workers or default_threads()


def announce(seconds: float, cores: int | None, *, most: bool = False) -> None:
    """Print the estimated time of the work on stderr, if it is more than a minute.

    Parameters
    ----------
    seconds : float
        Processor time.
    cores : int or None
        Number of cores that share the work; None if it is not known.
    most : bool
        Whether the work may end earlier.
    """
    about = "at most about" if most else "about"
    if cores is None:
        text = f"{duration_text(seconds)} of processor time"
    else:
        seconds /= cores
        text = f"{duration_text(seconds)} on {cores} {'core' if cores == 1 else 'cores'}"
    if seconds > LONG:
        print(f"pcs-racing: this takes {about} {text} (less what an earlier run has done)", file=sys.stderr, flush=True)


def racing_seconds(races: int, duration: float) -> float:
    """Estimate the processor seconds of races of ``duration`` seconds each."""
    return RACING * races * duration


def shared_seconds(races: int, duration: float) -> float:
    """Estimate the same for races of several agents from the same starts: what they have in common is driven once."""
    return SHARED * racing_seconds(races, duration)


def tree_seconds(config: GameConfig, moves: int, trees: int, seeds: int) -> float:
    """Estimate the processor seconds of full game trees.

    Parameters
    ----------
    trees, seeds : int
        Number of trees, and of noise realisations in each tree.
    """
    return _tree(TREE_SEGMENT, config, moves**2) * trees * seeds


def ego_seconds(config: GameConfig, moves: int, roots: int) -> float:
    """Estimate the processor seconds of ego trees."""
    return _tree(EGO_SEGMENT, config, moves) * roots


def _tree(rate: float, config: GameConfig, branches: int) -> float:
    histories = sum(branches**step for step in range(config.moves + 1))
    return rate * histories * config.step_seconds / 8.0


def synthesis_seconds(config: ArchiveConfig) -> float:
    """Estimate the processor seconds of an archive: the races of its search, its selection and its measurement."""
    return RACING * sum(config.work.values())


def ppo_seconds(settings: PPOSettings) -> float:
    """Estimate the processor seconds of a training with all seeds; early stopping may shorten it."""
    rate = DUEL_MOVE if isinstance(settings, DuelSettings) else DRIVE_STEP
    return rate * settings.steps * len(settings.seeds)


def training_seconds(settings: TrainSettings) -> float:
    """Estimate the processor seconds of training a network; early stopping may shorten it."""
    return ROW * settings.rows_per_epoch * settings.epochs


def response_seconds(settings: ResponseSettings, config: GameConfig, moves: int, games: int) -> float:
    """Estimate the processor seconds of a response learned from branched games.

    Parameters
    ----------
    games : int
        Number of circuits times number of opponents.
    """
    racing = _branching(settings.starts * settings.rounds * games, config, moves)
    fits = settings.rounds * config.moves
    # Two networks after every step, all members after the last one, each on the rows of all steps so far.
    networks = [2] * (fits - 1) + [settings.members]
    return racing + sum(
        count * _fitting(settings, settings.starts * games * (i + 1)) for i, count in enumerate(networks)
    )


def _fitting(settings: ResponseSettings, rows: int) -> float:
    """Estimate the processor seconds of a network that learns from so many rows: at most all of them in an epoch."""
    train = settings.train_settings(0)
    return training_seconds(replace(train, rows_per_epoch=min(train.rows_per_epoch, rows)))


def _branching(games: int, config: GameConfig, moves: int) -> float:
    """Estimate the processor seconds of games that are branched at every step, each step in games of its own."""
    # A game is simulated to the step of its branching, and every branch from there to the end.
    steps = [(k + 1) + moves * (config.moves - k) for k in range(config.moves)]
    return racing_seconds(games, config.step_seconds * sum(steps))


def robust_seconds(settings: RobustSettings, config: GameConfig, moves: int, circuits: int) -> float:
    """Estimate the processor seconds of a robust response; arguments as for :func:`response_seconds`."""
    learned = 1 if settings.pool_share == 1.0 else 1 + 2 * settings.rounds
    return learned * response_seconds(settings.response(0), config, moves, circuits)


def psro_seconds(settings: PSROSettings, config: GameConfig, moves: int, circuits: int) -> float:
    """Estimate the processor seconds of policy-space response oracles; arguments as for :func:`response_seconds`."""
    pairs = settings.rounds * (settings.rounds - 1) // 2
    learning = settings.rounds * response_seconds(settings.response(0), config, moves, circuits)
    return learning + racing_seconds(pairs * settings.races * circuits, config.horizon)


def self_play_seconds(settings: SelfPlaySettings, config: GameConfig, moves: int, circuits: int) -> float:
    """Estimate the processor seconds of self-play; arguments as for :func:`response_seconds`."""
    racing = _branching(settings.starts * settings.iterations * circuits, config, moves)
    networks = settings.iterations * settings.members
    return racing + networks * training_seconds(settings.train_settings(1, 0))


def stage_estimates(config: StudyConfig) -> dict[str, float]:
    """Estimate the processor seconds of the long stages of a study; the other stages take seconds."""
    from pcs_racing_agents.learning.ppo.settings import load_ppo_settings
    from pcs_racing_agents.networks.settings import load_train_settings
    from pcs_racing_agents.synthesis.config import load_archive_config

    game = config.game
    moves = AXES_MOVES + int(bool(game.stay))
    circuits = len(config.circuits)
    trees = tree_seconds(game, AXES_MOVES, config.pairs * circuits, config.seeds)
    networks = training_seconds(load_train_settings(config.training)) * len(config.targets)
    pool = len(config.circuits) * len(config.response_pool)
    responses = (response_seconds(load_response_settings(name), game, moves, pool) for name in config.responses)
    plans = LEAD_PLAN_ROUNDS * 2 * config.fixed_targets
    candidates = 2 * config.fixed_targets + plans + moves + BLIND_ROUNDS * config.moves * moves
    blind = candidates * config.fitting_games * len(config.circuits) * len(config.fitting_opponents)
    tables = sum(
        len(tracks) * len(opponents) * len(arms) * config.egos * config.variants * lines * 2
        for tracks, opponents, arms, lines in config.tables.values()
    )
    plays = [load_self_play_settings(name) for name in (config.self_play, config.sampled_cfr) if name is not None]
    robust = None if config.robust is None else load_robust_settings(config.robust)
    psro = None if config.psro is None else load_psro_settings(config.psro)
    reply = response_seconds(load_response_settings(config.reply), game, moves, circuits)
    pairs = len(config.rated) * (len(config.rated) - 1) // 2
    races = pairs * config.rating_races * (len(config.tracks) + len(config.circuits))
    return {
        "archive": 0.0 if config.synthesis is None else synthesis_seconds(load_archive_config(config.synthesis)),
        "trees": trees,
        "networks": networks if config.pairs else 0.0,
        "blind": shared_seconds(blind, game.horizon),
        "responses": sum(responses),
        "self-play": sum(self_play_seconds(settings, game, moves, circuits) for settings in plays),
        "robust": 0.0 if robust is None else robust_seconds(robust, game, moves, circuits),
        "psro": 0.0 if psro is None else psro_seconds(psro, game, moves, circuits),
        "ppo": 0.0 if config.ppo is None else ppo_seconds(load_ppo_settings(config.ppo)),
        "races": shared_seconds(tables, game.horizon),
        "ratings": shared_seconds(races, game.horizon),
        "best-replies": len(config.replies) * (reply + racing_seconds(config.reply_races, game.horizon)),
    }
