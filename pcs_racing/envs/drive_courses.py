"""The circuits of a batch of drives: what all races on one of them share."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcs_racing.base.recently_used import RecentlyUsed
from pcs_racing.envs.circuits import Circuits
from pcs_racing.envs.drive_kernel import Sight
from pcs_racing.race.kernel import KernelSettings
from pcs_racing.race.races import RaceSetup, start_lines, start_races
from pcs_racing.race.start_grid import Starts
from pcs_racing.race.state import RaceState
from pcs_racing.track.frenet import TrackArrays

KEPT = 64  # circuits that no race is on


class Scene(NamedTuple):
    """What the kernel is handed for a run of races: the circuit, the rules, and what the players observe."""

    arrays: TrackArrays
    settings: KernelSettings
    sight: Sight


class Course(NamedTuple):
    """A circuit with what is needed to race on it."""

    setup: RaceSetup
    grid: RaceState  #: Races at all places that episodes begin at.
    scene: Scene  #: Of races without obstacles.


class Courses:
    """The circuits of a batch, each made when a race is first on it; those that were used last are kept.

    Parameters
    ----------
    setup : RaceSetup
        On any of the circuits.
    sight : Sight
        What the players observe; its ``ahead`` is set for each circuit.
    look_ahead : tuple of float
        Look-ahead distances, m.
    ittc : bool
        Whether the time to collision is measured, which costs time.
    races : int
        Races of the batch: as many circuits can be in use at once.
    """

    def __init__(
        self,
        circuits: Circuits,
        setup: RaceSetup,
        sight: Sight,
        look_ahead: tuple[float, ...],
        *,
        ittc: bool,
        races: int,
    ) -> None:
        self._circuits, self._setup, self._sight, self._look_ahead = circuits, setup, sight, look_ahead
        self._ittc = ittc
        self._known: RecentlyUsed[int, Course] = RecentlyUsed(KEPT + races)

    def on(self, circuit: int) -> Course:
        """Return the course on a circuit, by its number."""
        return self._known.get(circuit, lambda: self._make(circuit))

    def _make(self, circuit: int) -> Course:
        setup = replace(self._setup, track=self._circuits.track(circuit))
        line, ds = setup.track.arrays.line, setup.track.arrays.ds
        ahead = np.array([round(distance / ds) % len(line) for distance in self._look_ahead], np.int64)
        lines = start_lines(setup.track, setup.config, 0, split="train")
        places = Starts(np.repeat(lines, 2), np.tile(np.array([0, 1]), len(lines)))
        grid = start_races(setup, places, np.zeros(len(places), np.uint64))
        settings = setup.settings if self._ittc else setup.settings._replace(ittc_horizon=0.0)
        return Course(setup, grid, Scene(setup.track.arrays, settings, self._sight._replace(ahead=ahead)))
