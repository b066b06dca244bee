"""The headroom of a pool of policies on several circuits as text, files and pictures."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcs_racing_agents.base.style import COLOURS, EDGE, INK, new_figure, picture, short, tidy
from pcs_racing_agents.base.tables import aligned, write_csv
from pcs_racing_agents.cli.headroom import NOTE as SHORT_NOTE
from pcs_racing_agents.cli.headroom import headroom_row, mean_row, write_payoffs
from pcs_racing_agents.policies.headroom import (
    CyclicPlane,
    Headroom,
    cyclic_planes,
    headroom,
    ratings,
    transitive_share,
)
from pcs_racing_agents.solvers.matrix_games import solve_matrix_games
from studies.headroom.lead_plans import LeadPlanValue
from studies.headroom.slots import SlotHeadroom, slot_headroom

Floats = NDArray[np.float64]

HEAD = (
    "track",
    "H",
    "low",
    "opponents",
    "pool",
    "transitive",
    "in slot",
    "slot",
    "cycles",
    "strength",
    "noise",
    "equilibrium",
)
LEAD_HEAD = ("track", "lead plan", "error", "then H", "error", "ahead", "behind")
NOTE = """; in slot: H for a driver that knows its place on the grid, over the best fixed policy of
each place; slot: gain of choosing by the place alone; cycles: planes of rock, paper and scissors
stronger than noise; strength, noise: singular value of the first plane, and the value that noise
alone reaches in 95 of 100 draws; equilibrium: policies with more than 1 % of the probability"""
LEAD_NOTE = """lead plan: gain of the best plan "this policy ahead, that one behind" over
the best fixed policy; then H: gain of knowing the opponent for a driver with such plans, over the
best of them; errors: over opponents"""


class TrackGame(NamedTuple):
    """The game of choosing a policy on one circuit."""

    track: str  #: Name of the circuit.
    payoffs: Floats  #: shape (F, N, N): Mean over both slots of the grid.
    headroom: Headroom
    slots: SlotHeadroom
    transitive_share: float
    planes: list[CyclicPlane]  #: The strongest first.
    #: shape (N,): Probabilities of the policies in an equilibrium of the mean payoffs.
    equilibrium: Floats


def track_game(track: str, slots: Floats) -> TrackGame:
    """Return the statistics of the payoffs on one circuit.

    Parameters
    ----------
    slots : ndarray, shape (F, 2, N, N)
        See :func:`pcs_racing_agents.policies.policy_pool.slot_payoffs`.
    """
    payoffs = slots.mean(axis=1)
    return TrackGame(
        track=track,
        payoffs=payoffs,
        headroom=headroom(payoffs),
        slots=slot_headroom(slots),
        transitive_share=transitive_share(payoffs),
        planes=cyclic_planes(payoffs),
        equilibrium=solve_matrix_games(payoffs.mean(axis=0)).rows[0],
    )


def headroom_text(games: Sequence[TrackGame], names: Sequence[str]) -> str:
    """Return the table of all circuits, with their mean if there are several, and the meaning of
    its columns.
    """
    rows = [HEAD, *(_row(game) for game in games)]
    if len(games) > 1:
        places = (
            np.mean([getattr(game.slots, key) for game in games]) for key in ("value", "slot_alone")
        )
        rows.append(
            (*mean_row([game.headroom for game in games]), *_signed(*places), "", "", "", "")
        )
    best = [
        f"{game.track}: the best fixed policy is {names[game.headroom.best_fixed]}"
        for game in games
    ]
    return "\n".join([*aligned(rows), "", *best, "", SHORT_NOTE + NOTE])


def write_headroom(games: Sequence[TrackGame], names: Sequence[str], folder: Path) -> list[Path]:
    """Write ``headroom.csv``, a line for each circuit, and ``payoffs.csv``, a line for each two
    policies.
    """
    lines: list[tuple[object, ...]] = [(*HEAD[:5], "in_slot", "slot", "best_fixed")]
    for game in games:
        estimate, slots = game.headroom, game.slots
        errors = (estimate.opponents_error, estimate.pool_error)
        numbers = (estimate.value, estimate.low, *errors, slots.value, slots.slot_alone)
        lines.append(
            (game.track, *(f"{number:.6f}" for number in numbers), names[estimate.best_fixed])
        )
    tracks, payoffs = [game.track for game in games], [game.payoffs for game in games]
    written = write_csv(lines, folder / "headroom.csv")
    return [written, write_payoffs(tracks, payoffs, names, folder / "payoffs.csv")]


def lead_plan_rows(
    tracks: Sequence[str], values: Sequence[LeadPlanValue], names: Sequence[str]
) -> list[tuple[str, ...]]:
    """Return the table of the best lead plans, a row for each circuit and its heading."""
    rows: list[tuple[str, ...]] = [LEAD_HEAD]
    for track, value in zip(tracks, values, strict=True):
        gain, left = _signed(value.value, value.headroom)
        errors = f"{value.opponents_error:.3f}", f"{value.headroom_error:.3f}"
        rows.append(
            (track, gain, errors[0], left, errors[1], *(names[policy] for policy in value.best))
        )
    if len(values) > 1:
        means = _signed(
            *(np.mean([getattr(value, key) for value in values]) for key in ("value", "headroom"))
        )
        rows.append(("mean", means[0], "", means[1], "", "", ""))
    return rows


@picture
def headroom_picture(game: TrackGame, names: Sequence[str]) -> Any:
    """Draw the payoffs, with the policies in order of rating, and the strongest cyclic plane.

    In the plane a policy beats those that lie counterclockwise of it. The dashed circle is as far
    out as policies lie if noise alone makes the plane.
    """
    mean, rating = game.payoffs.mean(axis=0), ratings(game.payoffs)
    order = np.argsort(-rating, kind="stable")
    figure = new_figure(12.6, 5.6)
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
    image = left.imshow(mean[np.ix_(order, order)], cmap="PuOr", vmin=-0.5, vmax=0.5)
    labels = [short(names[i], 18) for i in order]
    left.set_xticks(
        range(len(order)), labels, rotation=60, ha="right", rotation_mode="anchor", fontsize=7
    )
    left.set_yticks(range(len(order)), labels, fontsize=7)
    left.set_title(f"{game.track}: races won minus one half, best rated first", fontsize=10)
    left.tick_params(length=0)
    figure.colorbar(image, ax=left, shrink=0.8)
    plane = game.planes[0]
    # Of N points that share a plane's strength evenly each lies at this distance: strength = sum of
    # squares / 2.
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    radius = np.sqrt(2.0 * plane.noise / len(names))
    right.plot(radius * np.cos(angle), radius * np.sin(angle), "--", color=EDGE, lw=1.0)
    points = right.scatter(
        *plane.points.T, c=rating, cmap="viridis", s=42, edgecolors=EDGE, zorder=3
    )
    for (x, y), name in zip(plane.points, names, strict=True):
        right.annotate(
            short(name, 18),
            (x, y),
            xytext=(4, 4),
            textcoords="offset points",
            fontsize=7,
            color=INK,
        )
    right.axhline(0.0, color=COLOURS[-1], lw=0.6)
    right.axvline(0.0, color=COLOURS[-1], lw=0.6)
    right.set_aspect("equal", adjustable="datalim")
    title = (
        f"cyclic plane, each beats what is counterclockwise: {plane.strength:.2f}, noise"
        f" {plane.noise:.2f}"
    )
    right.set_title(title, fontsize=10)
    figure.colorbar(points, ax=right, shrink=0.8, label="rating")
    tidy(right, "")
    return figure


def _row(game: TrackGame) -> tuple[str, ...]:
    plane = game.planes[0]
    return (
        *headroom_row(game.track, game.headroom, game.transitive_share),
        *_signed(game.slots.value, game.slots.slot_alone),
        str(sum(plane.strength > plane.noise for plane in game.planes)),
        f"{plane.strength:.2f}",
        f"{plane.noise:.2f}",
        str(int((game.equilibrium > 0.01).sum())),
    )


def _signed(*values: Any) -> tuple[str, ...]:
    return tuple(f"{value:+.3f}" for value in values)
