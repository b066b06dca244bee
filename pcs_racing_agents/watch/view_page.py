"""The page with a list and a player of races: a single file that loads and sends nothing.

Its parts are ``view.html`` (the list), ``pcs_racing/race/replay.html`` (the player, in its own
frame) and ``beside.html`` (the player's panel next to the track).
"""

import shlex
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np

from pcs_racing.base.packing import pack
from pcs_racing.race.replay import player_page
from pcs_racing_agents.tournament import RaceTable
from pcs_racing_agents.tournament.races import Categorical
from pcs_racing_agents.watch.pages import rendered
from pcs_racing_agents.watch.race_replays import RaceRepeater


def view_page(
    repeater: RaceRepeater,
    picks: Mapping[int, str],
    races: Mapping[int, Mapping[str, Any]],
    *,
    serve: bool = False,
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
    serve : bool
        True if :mod:`pcs_racing_agents.watch.view_server` repeats other races.
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
    rules = ", ".join(word for word in table.preset.words if word)
    data = {
        "title": title,
        "about": ", ".join([*parts, f"{rules} rules"] if rules else parts),
        **packed_races(table),
        "sides": ["left", "right"] if results.start == "side-by-side" else ["front", "rear"],
        "replays": list(picks.items()),
        "circuits": list(repeater.circuits.items()),
        "space": repeater.space,
        "serve": serve,
        "commands": [
            f"pcs-racing view {path} {option}" for option in ("--serve", "--index {race}")
        ],
    }
    source = "'self'" if serve else "'none'"
    return rendered(
        "pcs_racing_agents.watch",
        "view.html",
        title=title,
        allowed=f"img-src data:; connect-src {source}",
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
        "preset": races.preset.codes,
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
        "presets": list(races.preset.words),
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
