"""Ways to look at a planner alone: on an empty track, or at its views during a race."""

from collections.abc import Callable

import numpy as np
import pytest
from placed_cars import view_of

from pcs_racing import load_track, run_races
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.planner import Policy
from pcs_racing.race.config import Rules
from pcs_racing.race.driving import advance
from pcs_racing.race.races import RaceResult, RaceSetup, start_races
from pcs_racing.race.start_grid import Starts
from pcs_racing.track.maps import list_tracks
from pcs_racing.track.track import Track


@pytest.fixture(scope="session")
def shipped() -> list[Track]:
    """All circuits that ship with the project."""
    return [load_track(name) for name in list_tracks()]


def _straightest(track: Track, gap: float) -> float:
    """Where both cars of a pair stand on pieces of the line that are as straight as possible."""
    bend = np.abs(track.line[:, 5])
    return float(
        np.argmin(np.maximum(bend, np.roll(bend, round(gap / track.arrays.ds)))) * track.arrays.ds
    )


def _config(track: Track, **changes) -> Rules:
    gap = min(0.5 * track.length, 50.0)
    return Rules(start="staggered", start_gap=gap, start_spacing=0.0, **changes)


@pytest.fixture(scope="session")
def drive_alone() -> Callable[..., RaceResult]:
    """Race policies against themselves from so far apart that each car drives alone: two drives for
    each policy.
    """

    def drive(
        track: Track, policies: list[Policy], duration: float = 40.0, **changes
    ) -> RaceResult:
        config = _config(track, duration=duration, **changes)
        count = len(policies)
        starts = Starts(
            np.full(count, _straightest(track, config.start_gap)), np.zeros(count, np.int64)
        )
        return run_races(track, policies, policies, config, starts=starts)

    return drive


@pytest.fixture(scope="session")
def views() -> Callable[..., np.ndarray]:
    """Views of a driver every 0.3 s of some races: shape (N, VIEW_SIZE)."""

    def collect(track: Track, policy: Policy, config: Rules, starts: Starts) -> np.ndarray:
        setup = RaceSetup(track, config, (policy.planner, policy.planner))
        state = start_races(setup, starts, np.arange(len(starts), dtype=np.uint64))
        theta = np.tile(policy.parameters, (len(starts), 2, 1))
        seen = []
        while (state.tick < config.ticks).any() and not state.crashed.all():
            for race in np.flatnonzero(~state.crashed):
                seen += [view_of(setup, state, race, car) for car in range(2)]
            before = int(state.tick.max())
            advance(setup, state, theta, 30)
            if int(state.tick.max()) == before:
                break
        return np.array(seen)

    return collect


@pytest.fixture(scope="session")
def view_at() -> Callable[..., np.ndarray]:
    """View of the driver of a car at (s, d), with the opponent at rest a gap ahead of it."""

    def look(
        track: Track,
        s: float,
        d: float = 0.0,
        *,
        speed=4.0,
        turned=0.0,
        gap=20.0,
        opp_d=0.0,
        opp_speed=0.0,
    ):
        setup = RaceSetup(track, _config(track), (LATTICE, LATTICE))
        state = start_races(
            setup, Starts(np.zeros(1), np.zeros(1, np.int64)), np.zeros(1, np.uint64)
        )
        for car, (at, across, v, extra) in enumerate(
            [(s, d, speed, turned), (s + gap, opp_d, opp_speed, 0.0)]
        ):
            x, y, psi = track.to_cartesian([at % track.length, across])
            state.cars[0, car] = [x, y, 0.0, v, (psi + extra) % (2.0 * np.pi), 0.0, 0.0]
            state.frenet[0, car] = at % track.length, across
            state.progress[0, car] = at
        return view_of(setup, state, 0, 0)

    return look
