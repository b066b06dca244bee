"""``pcs-racing headroom``: value of knowing the opponent's policy in an archive or policy pool."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from pcs_racing.game.archive_files import load_archive
from pcs_racing.track.loading import as_track, load_track
from pcs_racing_agents.agents.own_code import parse_own_policy
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.base.progress import show_progress
from pcs_racing_agents.base.tables import aligned, write_csv
from pcs_racing_agents.cli.commands import Option, command
from pcs_racing_agents.cli.options import (
    DEFAULT_TRACK,
    POLICY_HELP,
    ArchiveName,
    Circuits,
    Rules,
    Workers,
    archive_for,
)

if TYPE_CHECKING:
    from pcs_racing_agents.policies.headroom import Headroom
    from pcs_racing_agents.policies.policy_pool import PolicyPool

POOL_SIZE = 16
"""Default size of a pool: all pairs of its policies race in less than a minute per track."""
NOTE = """H: value of knowing the opponent before the start, in races won, over the best fixed
policy; low: a lower bound; opponents, pool: standard errors over opponents and over draws of the
pool; transitive: share of the payoffs' variance that ratings explain, noise removed"""


@dataclass(frozen=True, kw_only=True)
class PoolOptions:
    """A pool of policies: where they come from, and the races of all pairs of them."""

    track: Circuits = (DEFAULT_TRACK,)
    archive: ArchiveName = None
    size: Annotated[
        int | None,
        Option(
            "policies of the pool, evenly spaced in the order of the archive's first axis "
            f"(default: {POOL_SIZE}, or all if the archive has fewer)"
        ),
    ] = None
    policies: Annotated[
        Sequence[str], Option(f"a pool of your own instead of an archive: {POLICY_HELP}", "POLICY")
    ] = ()
    rules: Rules
    races: Annotated[int, Option("races of each pair on each track")] = 64

    def pool(self) -> "tuple[list[str], PolicyPool]":
        """Return the names of the pool's policies, and the pool."""
        from pcs_racing_agents.policies.policy_pool import PolicyPool, spanning_policies

        if self.policies:
            names, policies = (
                list(self.policies),
                tuple(parse_own_policy(text) for text in self.policies),
            )
        else:
            archive = load_archive(archive_for(self.archive, self.rules.config()))
            names, policies = spanning_policies(
                archive, min(POOL_SIZE, len(archive)) if self.size is None else self.size
            )
        tracks = tuple(load_track(name) for name in self.track)
        return names, PolicyPool(
            policies, tracks, self.rules.config(), races=self.races, seed=self.rules.seed
        )


def pool_settings(pool: "PolicyPool") -> dict[str, Any]:
    """Return the values that identify a job of a pool's races."""
    return {
        "tracks": [as_track(track).content_hash for track in pool.tracks],
        "policies": [
            [policy.planner.name, *policy.parameters.tolist()] for policy in pool.policies
        ],
        "race": repr(pool.config),
        "races": pool.races,
        "folds": pool.folds,
        "seed": pool.seed,
    }


@command(
    "headroom",
    "pcs-racing headroom --rules contest --out out/headroom",
    "pcs-racing headroom --policies lattice:pace=0.2 lattice:pace=0.6 lattice --rules contest --out"
    " out/mine",
)
def run(
    *,
    options: PoolOptions,
    out: Annotated[
        Path,
        Option("folder for headroom.csv and payoffs.csv; an interrupted run resumes here", "DIR"),
    ],
    workers: Workers,
) -> None:
    """Race all pairs of an archive's policies, and print the value of knowing the opponent."""
    from pcs_racing_agents.policies.headroom import headroom, transitive_share
    from pcs_racing_agents.policies.policy_pool import pool_payoffs

    names, pool = options.pool()
    tracks = [as_track(track).name for track in pool.tracks]
    with workers.start() as executor, open_job(out, "headroom", pool_settings(pool)) as job:
        payoffs = pool_payoffs(pool, job=job, executor=executor, progress=show_progress("blocks"))
        found = [headroom(folds) for folds in payoffs]
        shares = [transitive_share(folds) for folds in payoffs]
        rows: list[tuple[str, ...]] = [("track", "H", "low", "opponents", "pool", "transitive")]
        rows += [headroom_row(*line) for line in zip(tracks, found, shares, strict=True)]
        if len(found) > 1:
            rows.append(mean_row(found))
        best = [
            f"{name}: the best fixed policy is {names[one.best_fixed]}"
            for name, one in zip(tracks, found, strict=True)
        ]
        print("\n".join([*aligned(rows), "", *best, "", NOTE]))
        lines: list[tuple[object, ...]] = [(*rows[0][:5], "best_fixed")]
        for name, one in zip(tracks, found, strict=True):
            numbers = (one.value, one.low, one.opponents_error, one.pool_error)
            lines.append((name, *(f"{number:.6f}" for number in numbers), names[one.best_fixed]))
        print(f"written: {write_csv(lines, out / 'headroom.csv')}")
        print(f"written: {write_payoffs(tracks, payoffs, names, out / 'payoffs.csv')}")


def headroom_row(track: str, estimate: "Headroom", share: float) -> tuple[str, ...]:
    """Return the texts of a track: headroom, its bound, its two errors, and transitive share."""
    errors = (estimate.opponents_error, estimate.pool_error)
    return (
        track,
        f"{estimate.value:+.3f}",
        f"{estimate.low:+.3f}",
        *(f"{error:.3f}" for error in errors),
        f"{share:.2f}",
    )


def mean_row(estimates: "Sequence[Headroom]") -> tuple[str, ...]:
    """Return the texts of the mean over tracks, with errors of each policy's mean over tracks."""
    from pcs_racing_agents.policies.headroom import jackknife_error

    # The same policies race on all tracks: errors are computed from each policy's mean over tracks.
    gains = np.mean([estimate.gains for estimate in estimates], axis=0)
    error = float(gains.std(ddof=1) / np.sqrt(len(gains)))
    pool = jackknife_error(np.mean([estimate.without for estimate in estimates], axis=0))
    means = (
        np.mean([getattr(estimate, key) for estimate in estimates]) for key in ("value", "low")
    )
    return ("mean", *(f"{mean:+.3f}" for mean in means), f"{error:.3f}", f"{pool:.3f}", "")


def write_payoffs(
    tracks: Sequence[str], payoffs: Iterable[Any], names: Sequence[str], file: Path
) -> Path:
    """Write a line per track and pair of policies: mean payoff over all folds, standard error."""
    lines: list[tuple[object, ...]] = [("track", "policy", "opponent", "payoff", "error")]
    for track, folds in zip(tracks, payoffs, strict=True):
        mean, error = folds.mean(axis=0), folds.std(axis=0, ddof=1) / np.sqrt(len(folds))
        lines += [
            (track, names[i], names[j], f"{mean[i, j]:.6f}", f"{error[i, j]:.6f}")
            for i, j in np.ndindex(mean.shape)
            if i != j
        ]
    return write_csv(lines, file)
