"""Archives on other axes: the same policies, with coordinates on learned characteristics or any others."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np

from pcs_racing.base.checks import check_names
from pcs_racing.base.errors import InputError
from pcs_racing.base.settings import Settings, setting, whole
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.race.config import RaceConfig
from pcs_racing.track.track import Track
from pcs_racing_agents.base.jobs import Run
from pcs_racing_agents.policies.evaluate import draw_scenarios, race_policies, summarise
from studies.axes.behaviour import run_blocks
from studies.axes.learn import spread_over
from studies.axes.learned import LearnedCharacteristics, register_learned


@dataclass(frozen=True)
class ApplySettings(Settings):
    """Races that measure the policies of an archive on new axes, on each circuit."""

    opponents: int = setting(12, whole(1, 1000), "Opponents of every policy, evenly spaced in the archive's order.")
    starts: int = setting(4, whole(1, 1000), "Start lines for each opponent.")
    explored_opponents: int = setting(4, whole(1, 1000), "Opponents of every explored policy, one start line each.")


def apply_characteristics(
    archive: PolicyArchive,
    learned: LearnedCharacteristics | None,
    tracks: Sequence[Track | str],
    config: RaceConfig,
    *,
    axes: Sequence[str] | None = None,
    name: str | None = None,
    settings: ApplySettings | None = None,
    seed: int = 0,
    **run: Unpack[Run],
) -> PolicyArchive:
    """Return an archive with the same policies and other axes.

    Its moves, observations, trees and agents are those of any archive: a move asks for more or less of a learned axis.
    A process that reads it from a file must know the learned axes (:func:`studies.axes.learned.load_learned`).

    Parameters
    ----------
    learned : LearnedCharacteristics or None
        Registered here, and in the processes that race.
    tracks : sequence of Track or str
        Where the policies race the archive's own.
    config : RaceConfig
        Its duration is a multiple of the archive's segments.
    axes : sequence of str, optional
        Names of characteristics, learned or not; by default all of ``learned``.
    name : str, optional
        Of the new archive; by default the archive's with the set's.
    seed : int
        Root of start lines and noise.
    """
    settings = settings or ApplySettings()
    if learned is not None:
        register_learned(learned)
    if axes is None:
        if learned is None:
            raise InputError("there are neither axes nor learned characteristics; give one of them")
        axes = learned.names
    axes = check_names("axes", list(axes))
    get_characteristics(axes)
    archive.family()
    seconds = archive.settings.get("segment_seconds", 8.0)
    length = float(seconds) if isinstance(seconds, int | float) else 8.0
    rivals = spread_over([archive.policy(i) for i in range(len(archive))], settings.opponents)
    few = spread_over(rivals, settings.explored_opponents)
    measured = {}
    for label, parameters, opponents, starts, root in (
        ("coordinates", archive.complete(archive.parameters), rivals, settings.starts, 0),
        ("explored", archive.complete(archive.explored_parameters), few, 1, 1),
    ):
        if len(parameters) == 0:
            continue
        scenarios = draw_scenarios(
            tracks,
            config,
            np.array([policy.parameters for policy in opponents]),
            axes,
            planner=archive.planner,
            starts=starts,
            segment_seconds=length,
            seed=int(np.random.SeedSequence(seed, spawn_key=(root,)).generate_state(1)[0]),
        )
        raced = run_blocks(scenarios, parameters, learned, race_policies, label, **run)
        measured[label] = summarise(raced)
    values: dict[str, Any] = {key: getattr(archive, key) for key in archive.__dataclass_fields__}
    own, explored = measured["coordinates"], measured.get("explored")
    values |= {
        "name": name or (f"{archive.name}-{learned.name}" if learned is not None else f"{archive.name}-axes"),
        "characteristics": axes,
        "coordinates": own.coordinates,
        "spread": own.spread,
        "own_crash": own.own_crash,
        "ideal": None,
        "nadir": None,
        "explored_coordinates": None if explored is None else explored.coordinates,
        "explored_own_crash": None if explored is None else explored.own_crash,
        "preset": config.name,
        "settings": {**archive.settings, **_facts(archive, tracks, config, settings, axes, length, seed)},
    }
    return PolicyArchive(**values)


def _facts(
    archive: PolicyArchive,
    tracks: Sequence[Track | str],
    config: RaceConfig,
    settings: ApplySettings,
    axes: Sequence[str],
    length: float,
    seed: int,
) -> dict[str, str | int | float]:
    """What the manifest says of the new coordinates."""
    return {
        "axes_of": archive.name,
        "axes_of_sha256": archive.content_hash,
        "characteristics": ", ".join(axes),
        "axes_tracks": ", ".join(track if isinstance(track, str) else track.name for track in tracks),
        "axes_duration": float(config.duration),
        "axes_opponents": settings.opponents,
        "axes_starts": settings.starts,
        "axes_explored_opponents": settings.explored_opponents,
        "axes_seed": seed,
        "segment_seconds": length,
    }
