"""Tournaments: every pair of competitors races."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

from pcs_racing.game.archive import PolicyArchive
from pcs_racing_agents.base.jobs import Run
from pcs_racing_agents.tournament.plan import (
    Circuit,
    Entrant,
    Rules,
    TournamentPlan,
    plan_tournament,
)
from pcs_racing_agents.tournament.races import concatenate_races
from pcs_racing_agents.tournament.result import Tournament
from pcs_racing_agents.tournament.runner import play_pairings


def play_tournament(
    tracks: Circuit | Sequence[Circuit],
    entrants: Sequence[Entrant] | Mapping[str, Entrant],
    rules: Rules = "paper",
    *,
    archive: PolicyArchive | str | Path = "default",
    races_per_pair: int = 20,
    seed: int = 0,
    like: Any = None,
    **run: Unpack[Run],
) -> Tournament:
    """Play every pair of competitors against each other; ``print`` shows the table of the result.

    All pairs drive the same races (common random numbers): the same start lines, spread over the
    track, each from both sides, with the same start policies and the same noise.

    Parameters
    ----------
    tracks : Track, name or path, or a sequence of them
    entrants : sequence, or mapping by name
        At least two texts or objects (:func:`pcs_racing.racer`), with different names.
    rules : GameConfig, RaceConfig, str or path
        Rules. Race rules give a game of the same duration (:func:`game_rules`); their
        ``start_lines`` is not used, since every two races draw their own line.
    races_per_pair : int
        Number of races of each pair on each track; even, from 2 to 2000.
    seed : int
        Seed of start lines, start policies and noise, and of the draws of agents given by name.
    like : str, mapping or environment, optional
        Training environment of models that do not hold its arguments (:func:`pcs_racing.racer`).
    **run
        ``job``, ``executor``, ``progress`` as for
        :func:`pcs_racing_agents.tournament.play_pairings`; open a job with
        :func:`tournament_settings`.
    """
    plan = plan_tournament(
        tracks,
        entrants,
        rules,
        archive=archive,
        races_per_pair=races_per_pair,
        seed=seed,
        like=like,
    )
    return play_plan(plan, **run)


def play_plan(plan: TournamentPlan, **run: Unpack[Run]) -> Tournament:
    """Play a planned tournament; see :func:`play_tournament`."""
    return Tournament(plan, concatenate_races(play_pairings(plan.pairings, **run)))
