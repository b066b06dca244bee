"""Inputs of a report: the stages' results, read from their files, and example races."""

import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.race.replay import Replay
from pcs_racing_agents.base.curves import Curve
from pcs_racing_agents.base.folders import package_version
from pcs_racing_agents.base.tables import read_csv
from pcs_racing_agents.tournament.pairings import Pairing
from pcs_racing_agents.tournament.races import RaceTable
from pcs_racing_agents.watch.explain import explain_game
from pcs_racing_agents.watch.words import story

Floats = NDArray[np.float64]


LARGEST = 1e100


def read_curves(path: str | Path, *columns: str, x: str = "epoch") -> list[Curve]:
    """Read learning curves; by default a trained network's training and validation loss."""
    names = columns or ("training_loss", "validation_loss")
    rows = _rows(path, (x, *names))
    steps = np.array([_number(row[x], path) for row in rows])
    return [
        Curve(
            steps,
            np.array([_number(row[name], path) for row in rows]),
            name.removesuffix("_loss").replace("_", " "),
        )
        for name in names
    ]


def software() -> dict[str, str]:
    """Return the versions of the libraries that the results depend on, and the machine."""
    versions = {"pcs-racing": package_version(), "Python": platform.python_version()}
    for library in ("numpy", "numba", "torch", "cma", "moocore", "scipy", "matplotlib"):
        try:
            versions[library] = version(library)
        except PackageNotFoundError:
            continue
    return {**versions, "machine": f"{platform.system()} {platform.machine()}"}


def _rows(path: str | Path, columns: Sequence[str]) -> list[dict[str, str]]:
    table = read_csv(path)
    missing = [name for name in columns if name not in table.columns]
    if missing:
        raise InputError(f"{path} has no column {missing[0]!r}")
    return table.rows()


def _number(text: str | None, path: str | Path) -> float:
    try:
        value = float(text) if text else np.nan
    except ValueError:
        # Text is as invalid as infinity; an empty cell is an unknown number.
        value = np.inf
    if np.isinf(value) or abs(value) > LARGEST:
        raise InputError(f"{path} holds {text!r} where a number should be")
    return value


# Example races

KINDS = ("win", "loss", "crash")


class ExplainedRace(NamedTuple):
    """A race with explanation and replay for a report."""

    title: str
    text: str  #: Explanation; may be empty.
    replay: Replay
    #: Moves as an SVG picture; may be empty.
    #: Drawn by :func:`pcs_racing_agents.watch.pictures.explanation_picture`.
    picture: bytes = b""


class Highlight(NamedTuple):
    """An example race of an agent; of several, the report shows the smallest."""

    rank: int  #: Order of preference of its kind of race: 0 before 1.
    gap: float  #: Gap between the cars at the end, m.
    title: str
    race: int  #: Index in the pairing.
    races: int  #: Number of candidate races.


def select_highlights(races: RaceTable, baseline: RaceTable) -> dict[str, Highlight]:
    """Select an agent's win by switching, loss and crash, by kind, as far as they occurred.

    Preferences: a win in a race lost by the agent without moves, a loss in a race won by the agent
    without moves, a crash by the agent's fault after its first move. Of several such races, the
    race with the smallest final gap between the cars is selected.

    Parameters
    ----------
    races, baseline : RaceTable
        The same races, driven by the agent and by the agent that never switches.
    """
    clean, switched = ~races.crashed, races.switches[:, 0] > 0
    won, lost, fault = (
        clean & (races.winner == 0),
        clean & (races.winner == 1),
        races.fault[:, 0] > 0,
    )
    ego, comparison = races[0].ego, f"{baseline[0].ego} starts alike and"
    criteria = (
        {
            f"A win by switching; {comparison} loses": won & switched & (baseline.winner == 1),
            "A win, policies being switched": won & switched,
        },
        {f"A loss; {comparison} wins": lost & (baseline.winner == 0), "A loss": lost},
        {
            f"A crash that {ego} is to blame for": fault & (races.moves.codes[:, 0, 0] >= 0),
            f"A crash before the first move that {ego} is to blame for": fault,
        },
    )
    highlights = {}
    # Criteria of a kind, best first; the first criterion that any race meets is used.
    for kind, choices in zip(KINDS, criteria, strict=True):
        for rank, (title, mask) in enumerate(choices.items()):
            numbers = np.flatnonzero(mask)
            if len(numbers):
                race = int(numbers[np.argmin(np.abs(races.lead[numbers]))])
                highlights[kind] = Highlight(
                    rank, abs(float(races.lead[race])), title, race, len(numbers)
                )
                break
    return highlights


def watch_race(pairing: Pairing, race: int, title: str) -> ExplainedRace:
    """Repeat a race for the report; the pairing's ego makes moves."""
    explanation = explain_game(
        pairing.game, pairing.ego, pairing.opponent, **pairing.race_arguments(race)
    )
    picture = b""
    if find_spec("matplotlib") is not None:
        from pcs_racing_agents.base.style import picture_bytes
        from pcs_racing_agents.watch.pictures import explanation_picture

        picture = picture_bytes(explanation_picture(explanation))
    return ExplainedRace(title, story(explanation), explanation.replay, picture)
