"""Statistics of an agent's moves over many races, by step, lead, and pace of the opponent.

Leads and the opponent's pace are divided into thirds at each step, for bins of about equal size.
Pace is the first characteristic of the archive ("aggressiveness", "pace"), measured in the last
step: the agent's observation.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcs_racing.base.errors import InputError
from pcs_racing.game.archive import PolicyArchive
from pcs_racing_agents.agents.observing import earlier, opponent
from pcs_racing_agents.base.style import INK, SOFT, new_figure, picture, short
from pcs_racing_agents.base.tables import write_csv
from pcs_racing_agents.watch.explain import observed_lead

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]

LEADS = ("behind most", "between", "ahead most")
PACES = ("low", "middle", "high")


@dataclass(frozen=True, eq=False)
class Situations:
    """Counts of an agent's moves by situation."""

    agent: str
    moves: tuple[str, ...]  #: Names of the M moves.
    axis: str  #: Name of the characteristic used as pace.
    #: shape (m, 2): ``lead_edges``, ``pace_edges``: Edges between the thirds at each of m steps,
    #: of the lead in m, and of the opponent's pace in normalised units.
    lead_edges: Floats
    pace_edges: Floats
    #: shape (m, 3, 3, M): Races by step, third of the lead, third of the opponent's pace, and move.
    counts: Counts

    @property
    def shares(self) -> Floats:
        """Share of each move in its situation, shape (m, 3, 3, M); NaN without occurrences."""
        total = self.counts.sum(axis=-1, keepdims=True)
        return np.divide(
            self.counts, total, out=np.full(self.counts.shape, np.nan), where=total > 0
        )


def summarise(
    observations: ArrayLike,
    actions: ArrayLike,
    archive: PolicyArchive,
    moves: Sequence[str],
    agent: str,
) -> Situations:
    """Count the moves of an agent in B races.

    Parameters
    ----------
    observations : array_like, shape (B, D)
        The agent's last observation in each race: its column of
        :attr:`pcs_racing_agents.tournament.races.RaceTable.observations`.
    actions : array_like of int, shape (B, m)
        Indices of the agent's moves; -1 after a crash.
    archive : PolicyArchive
        The archive, along the game's axes.
    """
    observed, made = np.asarray(observations, np.float32), np.asarray(actions)
    axes = len(archive.characteristics)
    size = (made.shape[-1] + 1) * (2 * axes + 2) + 1
    if made.ndim != 2 or observed.shape != (len(made), size):
        raise InputError(
            f"observations have shape {observed.shape} and actions {made.shape}; B races of m moves"
            f" need (B, {size}) and (B, m), as play_games returns them for one car"
        )
    if not (made >= 0).any():
        raise InputError(
            f"{agent!r} made no move in these {len(made)} races; there is nothing to count"
        )
    steps = made.shape[1]
    counts = np.zeros((steps, 3, 3, len(moves)), np.int64)
    edges = np.full((2, steps, 2), np.nan)
    for k in range(steps):
        # Races that ended before this move are excluded: they would shift the thirds.
        rows = made[:, k] >= 0
        if not rows.any():
            continue
        before = earlier(observed[rows], axes, k)
        thirds = []
        for i, values in enumerate(
            (observed_lead(before, axes, k), opponent(before, axes)[:, 0].astype(np.float64))
        ):
            edges[i, k] = np.quantile(values, [1.0 / 3.0, 2.0 / 3.0])
            thirds.append(np.searchsorted(edges[i, k], values))
        # Unbuffered: "+=" would count races of one situation and move only once.
        np.add.at(counts[k], (thirds[0], thirds[1], made[rows, k]), 1)
    return Situations(agent, tuple(moves), archive.characteristics[0], edges[0], edges[1], counts)


def situations_text(situations: Situations) -> str:
    """Return the most frequent moves in every situation as text."""
    races = int(situations.counts[0].sum())
    lines = [
        f"{situations.agent}: moves by step, lead and {situations.axis} of the opponent, in {races}"
        " races (thirds of what occurred at each step)"
    ]
    shares = situations.shares
    for k in range(len(shares)):
        if not situations.counts[k].any():
            continue
        low, high = situations.lead_edges[k]
        slow, fast = situations.pace_edges[k]
        lines.append(
            f"move {k + 1}: lead up to {low:+.1f} m, to {high:+.1f} m, more; opponent's"
            f" {situations.axis} up to {slow:.2f}, to {fast:.2f}, more"
        )
        for i, lead in enumerate(LEADS):
            for j, pace in enumerate(PACES):
                count = int(situations.counts[k, i, j].sum())
                if count:
                    order = np.argsort(-shares[k, i, j], kind="stable")
                    often = [
                        f"{situations.moves[a]} {shares[k, i, j, a]:.0%}"
                        for a in order
                        if shares[k, i, j, a] >= 0.1
                    ]
                    races_text = f"{count:>6} race{'s' if count > 1 else ''}"
                    lines.append(
                        f"  {lead:<12} opponent {pace:<6} {races_text}: {', '.join(often)}"
                    )
    return "\n".join(lines)


def write_situations(situations: Situations, path: str | os.PathLike[str]) -> Path:
    """Write one CSV line per step, third of the lead, third of the opponent's pace, and move."""
    thirds = ("lead", "lead_low_m", "lead_high_m", "opponent", "pace_low", "pace_high")
    rows: list[tuple[object, ...]] = [("agent", "move_number", *thirds, "move", "races", "share")]
    shares = situations.shares
    for k, i, j, a in np.ndindex(*situations.counts.shape):
        bounds = [
            "" if not 0 <= edge <= 1 else f"{values[k, edge]:.4f}"
            for values, third in ((situations.lead_edges, i), (situations.pace_edges, j))
            for edge in (third - 1, third)
        ]
        share = "" if np.isnan(shares[k, i, j, a]) else f"{shares[k, i, j, a]:.4f}"
        lead, pace = (LEADS[i], *bounds[:2]), (PACES[j], *bounds[2:])
        count = int(situations.counts[k, i, j, a])
        rows.append((situations.agent, k + 1, *lead, *pace, situations.moves[a], count, share))
    return write_csv(rows, path)


@picture
def situations_picture(situations: Situations) -> Any:
    """Draw the shares as a heat map: one column of panels per step, one row per move."""
    shares = situations.shares
    steps, moves = shares.shape[0], len(situations.moves)
    figure = new_figure(1.4 + 1.75 * steps, 1.2 + 1.35 * moves)
    panels = figure.subplots(moves, steps, squeeze=False, sharex=True, sharey=True)
    for a in range(moves):
        for k in range(steps):
            axes = panels[a, k]
            # Up is ahead, right is high, as in the Policy Characteristic Space.
            axes.imshow(
                shares[k, :, :, a], cmap="Blues", vmin=0.0, vmax=1.0, origin="lower", aspect="auto"
            )
            for i, j in np.ndindex(3, 3):
                value = shares[k, i, j, a]
                if not np.isnan(value):
                    colour = "white" if value > 0.55 else INK
                    axes.text(
                        j,
                        i,
                        f"{100 * value:.0f}",
                        ha="center",
                        va="center",
                        fontsize=8,
                        color=colour,
                    )
            axes.set_xticks(range(3), PACES)
            axes.set_yticks(range(3), ("behind", "", "ahead"))
            axes.tick_params(length=0)
            axes.spines[:].set_visible(False)
            if a == 0:
                axes.set_title(f"move {k + 1}", fontsize=9)
        panels[a, 0].set_ylabel(situations.moves[a], color=INK)
    figure.supxlabel(f"opponent's {situations.axis} as measured, thirds", fontsize=9, color=SOFT)
    races = int(situations.counts[0].sum())
    figure.suptitle(
        f"{short(situations.agent)}: which move in which situation, % of {races} races",
        x=0.01,
        ha="left",
        fontsize=10,
    )
    return figure
