"""Which move in which situation? A summary of thousands of races by step, lead, and pace of the opponent.

Leads and the opponent's pace are cut into thirds of what occurred before each move: the thirds are about equally full,
and their edges are told. Pace is the first characteristic of the archive ("aggressiveness", "pace"), as it was measured
in the step before: what the agent knew.
"""

import csv
import io
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.base.files import write_atomically
from pcs_racing.game.archive import PolicyArchive
from pcs_racing_agents.agents.observing import earlier, opponent
from pcs_racing_agents.explain.explain import lead_seen
from pcs_racing_agents.pictures.style import INK, SOFT, new_figure, picture, short

__all__ = ["LEADS", "PACES", "Situations", "situations_picture", "situations_text", "summarise", "write_situations"]

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]

LEADS = ("behind most", "between", "ahead most")
PACES = ("low", "middle", "high")


@dataclass(frozen=True, eq=False)
class Situations:
    """How often an agent made each move in each situation.

    Attributes
    ----------
    agent : str
    moves : tuple of str
        Names of the M moves.
    axis : str
        The characteristic that pace is.
    lead_edges, pace_edges : ndarray, shape (m, 2)
        Between the thirds, for each of the m steps: of the lead in m, and of the opponent's pace in the archive's
        normalised units.
    counts : ndarray, shape (m, 3, 3, M)
        Races by step, third of the lead, third of the opponent's pace, and move made.
    """

    agent: str
    moves: tuple[str, ...]
    axis: str
    lead_edges: Floats
    pace_edges: Floats
    counts: Counts

    @property
    def shares(self) -> Floats:
        """Share of each move in its situation, shape (m, 3, 3, M); NaN where the situation did not occur."""
        total = self.counts.sum(axis=-1, keepdims=True)
        return np.divide(self.counts, total, out=np.full(self.counts.shape, np.nan), where=total > 0)


def summarise(seen: ArrayLike, made: ArrayLike, archive: PolicyArchive, moves: Sequence[str], agent: str) -> Situations:
    """Count the moves that an agent made in B races.

    Parameters
    ----------
    seen : array_like, shape (B, D)
        What it saw until the end of each race: its column of
        :attr:`pcs_racing_agents.tournament.matches.Matches.seen`, as ``play_games`` returns it (results that come out
        of a job's folder have lost it).
    made : array_like of int, shape (B, m)
        The moves that it made; -1 after a crash.
    archive : PolicyArchive
        Seen along the game's axes.
    moves : sequence of str
        Names of the moves.
    agent : str

    Raises
    ------
    InputError
        If it made no move, or the arrays do not fit each other.
    """
    observations, chosen = np.asarray(seen, np.float32), np.asarray(made)
    axes = len(archive.characteristics)
    size = (chosen.shape[-1] + 1) * (2 * axes + 2) + 1
    if chosen.ndim != 2 or observations.shape != (len(chosen), size):
        raise InputError(
            f"seen has shape {observations.shape} and made {chosen.shape}; B races of m moves need (B, {size}) and "
            "(B, m), as play_games returns them for one car"
        )
    if not (chosen >= 0).any():
        raise InputError(f"{agent!r} made no move in these {len(chosen)} races; there is nothing to count")
    steps = chosen.shape[1]
    counts = np.zeros((steps, 3, 3, len(moves)), np.int64)
    edges = np.full((2, steps, 2), np.nan)
    for k in range(steps):
        rows = chosen[:, k] >= 0
        if not rows.any():
            continue
        before = earlier(observations[rows], axes, k)
        places = []
        for which, values in enumerate((lead_seen(before, axes, k), opponent(before, axes)[:, 0].astype(np.float64))):
            edges[which, k] = np.quantile(values, [1.0 / 3.0, 2.0 / 3.0])
            places.append(np.searchsorted(edges[which, k], values))
        np.add.at(counts[k], (places[0], places[1], chosen[rows, k]), 1)
    return Situations(agent, tuple(moves), archive.characteristics[0], edges[0], edges[1], counts)


def situations_text(found: Situations) -> str:
    """Return the summary for people: the most frequent moves of every situation."""
    races = int(found.counts[0].sum())
    lines = [
        f"{found.agent}: moves by step, lead and {found.axis} of the opponent, in {races} races "
        "(thirds of what occurred at each step)"
    ]
    shares = found.shares
    for k in range(len(shares)):
        if not found.counts[k].any():
            continue
        low, high = found.lead_edges[k]
        slow, fast = found.pace_edges[k]
        lines.append(
            f"move {k + 1}: lead up to {low:+.1f} m, to {high:+.1f} m, more; opponent's {found.axis} up to {slow:.2f}, "
            f"to {fast:.2f}, more"
        )
        for i, lead in enumerate(LEADS):
            for j, pace in enumerate(PACES):
                count = int(found.counts[k, i, j].sum())
                if count:
                    order = np.argsort(-shares[k, i, j], kind="stable")
                    often = [f"{found.moves[a]} {shares[k, i, j, a]:.0%}" for a in order if shares[k, i, j, a] >= 0.1]
                    races_told = f"{count:>6} race{'s' if count > 1 else ''}"
                    lines.append(f"  {lead:<12} opponent {pace:<6} {races_told}: {', '.join(often)}")
    return "\n".join(lines)


def write_situations(found: Situations, path: str | os.PathLike[str]) -> Path:
    """Write one line for each step, third of the lead, third of the opponent's pace, and move as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    thirds = ("lead", "lead_low_m", "lead_high_m", "opponent", "pace_low", "pace_high")
    writer.writerow(("agent", "move_number", *thirds, "move", "races", "share"))
    shares = found.shares
    for k, i, j, a in np.ndindex(*found.counts.shape):
        bounds = [
            "" if not 0 <= edge <= 1 else f"{values[k, edge]:.4f}"
            for values, third in ((found.lead_edges, i), (found.pace_edges, j))
            for edge in (third - 1, third)
        ]
        share = "" if np.isnan(shares[k, i, j, a]) else f"{shares[k, i, j, a]:.4f}"
        lead, pace = (LEADS[i], *bounds[:2]), (PACES[j], *bounds[2:])
        writer.writerow((found.agent, k + 1, *lead, *pace, found.moves[a], int(found.counts[k, i, j, a]), share))
    write_atomically(Path(path), lambda file: file.write(text.getvalue().encode("utf-8")))
    return Path(path)


@picture
def situations_picture(found: Situations) -> Any:
    """Draw the shares as a heat map: a column of panels for each step, a row for each move.

    Raises
    ------
    ModuleNotFoundError
        If matplotlib is not installed.
    """
    shares = found.shares
    steps, moves = shares.shape[0], len(found.moves)
    figure = new_figure(1.4 + 1.75 * steps, 1.2 + 1.35 * moves)
    panels = figure.subplots(moves, steps, squeeze=False, sharex=True, sharey=True)
    for a in range(moves):
        for k in range(steps):
            axes = panels[a, k]
            # Up is ahead, right is high, as in the Policy Characteristic Space.
            axes.imshow(shares[k, :, :, a], cmap="Blues", vmin=0.0, vmax=1.0, origin="lower", aspect="auto")
            for i, j in np.ndindex(3, 3):
                value = shares[k, i, j, a]
                if not np.isnan(value):
                    colour = "white" if value > 0.55 else INK
                    axes.text(j, i, f"{100 * value:.0f}", ha="center", va="center", fontsize=8, color=colour)
            axes.set_xticks(range(3), PACES)
            axes.set_yticks(range(3), ("behind", "", "ahead"))
            axes.tick_params(length=0)
            axes.spines[:].set_visible(False)
            if a == 0:
                axes.set_title(f"move {k + 1}", fontsize=9)
        panels[a, 0].set_ylabel(found.moves[a], color=INK)
    figure.supxlabel(f"opponent's {found.axis} as measured, thirds", fontsize=9, color=SOFT)
    races = int(found.counts[0].sum())
    figure.suptitle(
        f"{short(found.agent)}: which move in which situation, % of {races} races", x=0.01, ha="left", fontsize=10
    )
    return figure
