"""``python -m studies reading``: does a move depend on the opponent's place, and can a reader
predict it?
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from pcs_racing.game.archive_files import load_archive
from pcs_racing.game.make import make_game
from pcs_racing.game.players import competitor
from pcs_racing.track.loading import load_track
from pcs_racing_agents.agents.observing import earlier, lead, opponent, own
from pcs_racing_agents.base.statistics import clustered_mean
from pcs_racing_agents.base.tables import aligned, with_interval, write_csv
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import Circuits, RaceOptions, output_folder
from pcs_racing_agents.tournament.pairings import cross_pairing

Labels = NDArray[np.int64]
HEAD = (
    "agent",
    "circuit",
    "decisions",
    "bits",
    "p",
    "changed",
    "own place",
    "reader",
    "difference",
    "with the lead",
)


def information(opponents: Labels, moves: Labels, given: Labels) -> float:
    """Return the mutual information of two labels given a third one, in bits."""

    def entropy(*columns: Labels) -> float:
        share = np.unique(np.stack(columns), axis=1, return_counts=True)[1] / len(moves)
        return float(-(share * np.log2(share)).sum())

    return (
        entropy(opponents, given)
        + entropy(moves, given)
        - entropy(opponents, moves, given)
        - entropy(given)
    )


def right(
    cells: Labels, moves: Labels, half: Labels, otherwise: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """Return where the most frequent move of a cell in the other half is the move; ``otherwise`` in
    new cells.
    """
    hits = np.zeros(len(moves), np.bool_) if otherwise is None else otherwise.copy()
    for cell, test in {(int(cell), int(part)) for cell, part in zip(cells, half, strict=True)}:
        seen, asked = (cells == cell) & (half != test), (cells == cell) & (half == test)
        if seen.any():
            hits[asked] = moves[asked] == np.bincount(moves[seen]).argmax()
    return hits


def read(
    game: Any, agent: Any, raced: dict[str, Any], variants: Labels, seed: int
) -> tuple[object, ...]:
    """Return the numbers of a line from all races of an agent; ``variants``, shape (egos,
    opponents, races, 2).
    """
    axes, rng = len(game.archive.characteristics), np.random.default_rng(seed)
    middle, made = np.median(game.archive.normalised, axis=0), raced["moves"][:, 0].astype(np.int64)
    own_place, place, third = (np.full(made.shape, -1) for _ in range(3))
    changed = []
    for k in range(made.shape[1]):
        rows = np.flatnonzero(made[:, k] >= 0)
        before = earlier(raced["observations"][rows, 0], axes, k)
        seen, ahead = opponent(before, axes), lead(before, axes)
        if len(rows) == 0 or not np.ptp(seen):  # on the grid nothing has been measured
            continue
        own_place[rows, k], place[rows, k] = (
            (at >= middle) @ (1, 2) for at in (own(before, axes)[:, :2], seen[:, :2])
        )
        third[rows, k] = np.searchsorted(np.quantile(ahead, [1 / 3, 2 / 3]), ahead)
        swapped = before.copy()
        blocks, donors = (
            array[:, :-1].reshape(len(rows), -1, 2 * axes + 2) for array in (swapped, before)
        )
        blocks[..., axes : 2 * axes] = donors[rng.permutation(len(rows)), :, axes : 2 * axes]
        changed.append(
            agent.probabilities(before).argmax(axis=1)
            != agent.probabilities(swapped).argmax(axis=1)
        )
    given = np.arange(made.shape[1]) * 4 + own_place
    grid = place.reshape(*variants.shape[:3], -1)
    bits = []
    for draw in range(200):
        order = rng.permutation(grid.shape[1]) if draw else np.arange(grid.shape[1])
        other = grid[:, order].reshape(made.shape)
        both = (place >= 0) & (other >= 0)
        bits.append(information(other[both], made[both], given[both]))
    known = place >= 0
    egos, rivals = (
        np.repeat(variants[..., car].reshape(-1, 1), made.shape[1], axis=1)[known] for car in (0, 1)
    )
    columns = given[known], made[known], np.unique(rivals, return_inverse=True)[1] % 2
    own_rule = right(*columns)
    cells = 4 * given[known] + place[known]
    reader = right(cells, *columns[1:], own_rule)
    further = right(3 * cells + third[known], *columns[1:], reader)
    gain = clustered_mean(reader.astype(np.float64) - own_rule, egos, rivals)
    p, difference = (
        np.mean(np.array(bits) >= bits[0]),
        with_interval(gain.mean, gain.low, gain.high),
    )
    shares = (f"{part.mean():.3f}" for part in (p, np.concatenate(changed), own_rule, reader))
    return int(known.sum()), f"{bits[0]:.4f}", *shares, difference, f"{further.mean():.3f}"


@command("reading", "python -m studies reading --rules contest --archive contest --out out/reading")
def run(
    *,
    agents: Annotated[Sequence[str], Option("agents whose moves are read", "AGENT")] = (
        "cfr-argmax",
        "response",
    ),
    track: Circuits = ("Tarnfjord", "Brackwater"),
    archive: Annotated[str, Option("archive: its name or folder", "A")] = "default",
    rules: RaceOptions,
    out: Annotated[Path, Option("folder for reading.csv", "DIR")],
) -> None:
    """Race agents against policies that stay, and report how well the opponent's place predicts
    their moves.
    """
    spec = make_game(None, load_archive(archive), rules.read())
    egos, rival = [competitor(name, spec) for name in agents], competitor("never-switch", spec)
    lines: list[tuple[object, ...]] = [HEAD]
    for name in track:
        game = make_game(load_track(name), spec.archive, spec.rules)
        pairing = cross_pairing(
            game, egos[0], rival, egos=12, opponents=24, lines=3, seed=rules.seed
        )
        variants = pairing.variants.reshape(len(np.unique(pairing.variants[:, 0])), -1, 6, 2)
        for label, agent, raced in zip(agents, egos, pairing.race(egos), strict=True):
            lines.append((label, name, *read(game, agent, raced, variants, rules.seed)))
    print("\n".join(aligned([[str(cell) for cell in line] for line in lines])))
    print(f"written: {write_csv(lines, output_folder(out) / 'reading.csv')}")
