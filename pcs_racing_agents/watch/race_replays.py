"""Replays of races for the viewer, with the moves in the Policy Characteristic Space.

A replay of the viewer is a smaller form of a :mod:`pcs_racing.race.replay`: walls and race line are
stored once for all races, plans every 0.2 s, and no times to collision.

The page with a list and a player of races: a single file that loads and sends nothing.

Its parts are ``view.html`` (the list), ``pcs_racing/race/replay.html`` (the player, in its own
frame) and ``beside.html`` (the player's panel next to the track).
"""

import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pcs_racing.base.packing import pack
from pcs_racing.base.typing import Floats
from pcs_racing.game.archive import PolicyArchive
from pcs_racing.game.characteristics import get_characteristics
from pcs_racing.race.replay import page_values, player_page
from pcs_racing_agents.agents.observing import moves_made, opponent, step_count
from pcs_racing_agents.base.jobs import Progress
from pcs_racing_agents.policies.picture import axis_limits, plane
from pcs_racing_agents.tournament import RaceRow, RaceTable, repeat_race
from pcs_racing_agents.tournament.races import Categorical
from pcs_racing_agents.watch.explain import mark_moves
from pcs_racing_agents.watch.pages import rendered
from pcs_racing_agents.watch.results_folder import ResultsFolder

PLAN_SKIP = 2  # every second plan is stored
MAX_PAIRINGS = 64


class RaceRepeater:
    """A repeater of a results folder's races, with their shared data; not thread-safe."""

    def __init__(self, results: ResultsFolder) -> None:
        self.results = results
        #: Walls and lines of the tracks of the races so far, by name.
        self.circuits: dict[str, dict[str, Any]] = {}
        #: Policy Characteristic Space (:func:`space_values`); None before the first race.
        self.space: dict[str, Any] | None = None
        self._pairing = lru_cache(maxsize=MAX_PAIRINGS)(results.pairing)

    def drive(self, number: int) -> dict[str, Any]:
        """Repeat the race on a line of the results, and return its data for the page."""
        row = self.results.row(number)
        pair = RaceRow(track=row.track, ego=row.ego, opponent=row.opponent, seed=row.seed)
        recording = repeat_race(self._pairing(pair), row.race, candidates=False)
        played, game = recording.played, recording.game
        # An edited folder is detected by the lead.
        self.results.check_lead(number, played.lead[0])
        replay = mark_moves(recording.replay, played, game.moves, game.rules.ends)
        if replay.paths is not None:
            replay = replace(replay, paths=replay.paths[::PLAN_SKIP])
        replay = replace(replay, plan_dt=PLAN_SKIP * replay.plan_dt, ittc=None)
        values = page_values(replay)
        self.circuits[row.track] = {part: values.pop(part) for part in ("walls", "line")}
        if self.space is None:
            self.space = space_values(game.archive, game.moves)
        values["space"] = {
            "ends": game.rules.ends,
            "policies": played.path[0].tolist(),
            "made": played.moves.codes[0].tolist(),
            "seen": [_seen(game.archive, played, car) for car in range(2)],
        }
        return values

    def drive_all(
        self, numbers: Iterable[int], progress: Progress | None = None
    ) -> dict[int, dict[str, Any]]:
        """Repeat the races of several lines, and return their data."""
        races, order = {}, sorted(numbers)  # races of a pair follow each other
        for number in order:
            races[number] = self.drive(number)
            if progress is not None:
                progress(len(races), len(order), self.results.row(number).track)
        return races


def _seen(archive: PolicyArchive, played: RaceTable, car: int) -> list[list[float] | None]:
    """Return the places of the opponent that a car measured in each step; None after a crash."""
    assert played.observations is not None
    observation, axes = played.observations[:, car], len(archive.characteristics)
    steps = step_count(observation, axes)
    complete = np.arange(steps) <= moves_made(observation, axes)[0]  # without steps after a crash
    measured = np.array([opponent(observation, axes, step)[0] for step in range(steps)])
    units = archive.nadir + measured.reshape(-1, axes) * (archive.ideal - archive.nadir)
    places = _places(archive, units)
    return [place if known else None for place, known in zip(places, complete, strict=True)]


def space_values(archive: PolicyArchive, moves: Sequence[str]) -> dict[str, Any]:
    """Return the Policy Characteristic Space as plain values for the page's JSON.

    Places are shares of the picture's width and height, from the left and lower edge.
    """
    columns, kinds = plane(archive), get_characteristics(archive.characteristics)
    low, high = _limits(archive)
    axes = [
        {"name": kinds[column].name, "unit": kinds[column].unit, "low": low[k], "high": high[k]}
        for k, column in enumerate(columns)
    ]
    explored = np.array(_places(archive, archive.explored_coordinates)).reshape(-1, 2)
    shares = archive.own_crash
    return {
        "archive": archive.name,
        "axes": axes,
        "moves": list(moves),
        "points": _places(archive, archive.coordinates),
        "explored": pack(explored[((explored >= 0.0) & (explored <= 1.0)).all(axis=1)], 4000),
        "crash": None if shares is None else np.round(100.0 * shares, 1).tolist(),
    }


def _limits(archive: PolicyArchive) -> Floats:
    """Return the lower and upper limits of the picture's axes, shape (2, 2)."""
    return np.transpose([axis_limits(archive, column, 0.5) for column in plane(archive)])


def _places(archive: PolicyArchive, points: ArrayLike) -> Any:
    """Return points in the characteristics' units as places in the picture: nested lists."""
    low, high = _limits(archive)
    shares = (np.asarray(points)[..., list(plane(archive))] - low) / (high - low)
    return np.round(shares, 4).tolist()


def view_page(
    repeater: RaceRepeater,
    picks: Mapping[int, str],
    races: Mapping[int, Mapping[str, Any]],
) -> str:
    """Return the page.

    A link may name filters, a race and a time, e.g.
    ``view.html#agent=response&crash=own&race=12&t=9.5``.

    Parameters
    ----------
    repeater : RaceRepeater
        Results, tracks and Policy Characteristic Space.
    picks : mapping
        Reason for each race with a replay, by its line of the results.
    races : mapping
        Data of these races (:meth:`RaceRepeater.drive_all`).
    """
    beside = files("pcs_racing_agents.watch").joinpath("beside.html").read_text(encoding="utf-8")
    results = repeater.results
    title, table, path = (
        results.folder.resolve().name,
        results.races,
        shlex.quote(f"{results.folder}"),
    )
    parts = [
        _count(len(table), "race"),
        _count(len(table.agents.words), "agent"),
        _count(len(table.track.words), "circuit"),
    ]
    rules = ", ".join(word for word in table.rules.words if word)
    data = {
        "title": title,
        "about": ", ".join([*parts, f"{rules} rules"] if rules else parts),
        **packed_races(table),
        "sides": ["left", "right"] if results.start == "side-by-side" else ["front", "rear"],
        "replays": list(picks.items()),
        "circuits": list(repeater.circuits.items()),
        "space": repeater.space,
        "command": f"pcs-racing view {path} --index {{race}}",
    }
    return rendered(
        "pcs_racing_agents.watch",
        "view.html",
        title=title,
        data=data,
        player=player_page().replace("<!--beside-->", beside),
        replays=races,
    )


def packed_races(races: RaceTable) -> dict[str, Any]:
    """Return races as plain values for the page's JSON.

    Leads are rounded to 1 mm, other lengths and times to 0.01; the rest is exact.
    """
    moves = _joined(races.moves)
    whole = {
        "ego": races.agents.codes[:, 0],
        "opponent": races.agents.codes[:, 1],
        "track": races.track.codes,
        "rules": races.rules.codes,
        "seed": races.seed.codes,
        "race": races.race,
        "side": races.side,
        "winner": races.winner + 1,
        "crash": races.crash,
        "fault": races.fault[:, 0] + 2 * races.fault[:, 1],
    }
    both = {
        "overtakes": races.overtakes,
        "variants": races.variants,
        "switches": races.switches,
        "moves": moves.codes,
    }
    whole |= {f"{name}{car}": values[:, car] for name, values in both.items() for car in range(2)}
    # Differences shorten runs of equal values, and numbers that count up, to a character each.
    return {
        "length": len(races),
        "agents": list(races.agents.words),
        "tracks": list(races.track.words),
        "rules": list(races.rules.words),
        "seeds": list(races.seed.words),
        "moves": list(moves.words),
        "columns": {
            **{name: pack(values.astype(np.int64), 1, [0]) for name, values in whole.items()},
            "start_s": pack(races.start_s, 100, [0]),
            "lead": pack(races.lead, 1000),
            "duration": pack(np.nan_to_num(races.duration, nan=-1.0), 100, [0]),
        },
    }


def _joined(moves: Categorical) -> Categorical:
    """Return lists of moves as texts, shape (N, 2)."""
    # Lists are compared as numbers, step by step; only distinct lists become texts.
    codes = np.zeros(moves.codes.shape[:2], np.int64)
    for step in range(moves.codes.shape[2]):
        # Renumbered after every step to avoid overflow.
        mixed = codes * (len(moves.words) + 1) + moves.codes[:, :, step] + 1
        codes = np.unique(mixed, return_inverse=True)[1].reshape(codes.shape)
    _, first = np.unique(codes, return_index=True)
    lists = moves.codes.reshape(codes.size, moves.codes.shape[2])[first].tolist()
    return Categorical(
        tuple("; ".join(moves.words[move] for move in indices if move >= 0) for indices in lists),
        codes,
    )


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
