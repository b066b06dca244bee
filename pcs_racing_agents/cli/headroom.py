"""``pcs-racing headroom``: the value of knowing the opponent's policy, in an archive or a pool of policies."""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pcs_racing.game.archive_files import load_archive
from pcs_racing.planners.registry import parse_policy
from pcs_racing.track.loading import as_track, load_track
from pcs_racing_agents.cli.options import POLICY_HELP, Commands, add_command, add_rules, add_tracks, rules
from pcs_racing_agents.jobs.executors import add_executor_options, executor_from
from pcs_racing_agents.jobs.jobs import open_job
from pcs_racing_agents.jobs.progress import show_progress
from pcs_racing_agents.results.csv_files import write_csv
from pcs_racing_agents.results.text_table import aligned

if TYPE_CHECKING:
    from pcs_racing_agents.payoffs.headroom import Headroom
    from pcs_racing_agents.payoffs.policy_pool import PolicyPool

MOST = 16
"""Policies of a pool whose size is not given: all pairs of them race in less than a minute a circuit."""
NOTE = """H: what knowing the opponent before the start is worth, in races won, over the best fixed policy; low: a bound
from below; opponents, pool: standard errors over opponents and over draws of the pool; transitive: share of the
payoffs' variance that ratings explain, noise removed"""


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "headroom",
        "race all pairs of an archive's policies, and print what knowing the opponent is worth",
        "pcs-racing headroom --archive contest --race contest --out out/headroom",
        "pcs-racing headroom --policies lattice:pace=0.2 lattice:pace=0.6 lattice --race contest --out out/mine",
    )
    add_pool_options(parser)
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for headroom.csv and payoffs.csv; a run that was stopped there goes on",
    )
    add_executor_options(parser)
    parser.set_defaults(run=run)


def add_pool_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that :func:`pool_from` reads."""
    add_tracks(parser)
    parser.add_argument("--archive", default="contest", help="archive: its name or folder (default: contest)")
    parser.add_argument(
        "--size",
        type=int,
        metavar="N",
        help="policies of the pool, evenly spaced in the order of the archive's first axis "
        f"(default: {MOST}, or all if the archive has fewer)",
    )
    parser.add_argument(
        "--policies", nargs="+", metavar="POLICY", help=f"a pool of your own instead of an archive: {POLICY_HELP}"
    )
    add_rules(parser)
    parser.add_argument(
        "--races", type=int, default=64, metavar="N", help="races of each pair on each track (default: 64)"
    )


def pool_from(arguments: argparse.Namespace) -> "tuple[list[str], PolicyPool]":
    """Return the pool that the options ask for, and the names of its policies."""
    from pcs_racing_agents.payoffs.policy_pool import PolicyPool, spanning_policies

    if arguments.policies:
        names, policies = list(arguments.policies), tuple(parse_policy(text) for text in arguments.policies)
    else:
        archive = load_archive(arguments.archive)
        size = min(MOST, len(archive)) if arguments.size is None else arguments.size
        names, policies = spanning_policies(archive, size)
    tracks = tuple(load_track(name) for name in arguments.track)
    return names, PolicyPool(policies, tracks, rules(arguments), races=arguments.races, seed=arguments.seed)


def pool_settings(pool: "PolicyPool") -> dict[str, Any]:
    """Return what a job of a pool's races must be the same in."""
    return {
        "tracks": [as_track(track).content_hash for track in pool.tracks],
        "policies": [[policy.planner.name, *policy.parameters.tolist()] for policy in pool.policies],
        "race": repr(pool.config),
        "races": pool.races,
        "folds": pool.folds,
        "seed": pool.seed,
    }


def run(arguments: argparse.Namespace) -> None:
    """Race all pairs, print the table, and write the files."""
    from pcs_racing_agents.cli.estimates import announce, cores_of, racing_seconds
    from pcs_racing_agents.payoffs.headroom import headroom, transitive_share
    from pcs_racing_agents.payoffs.policy_pool import pool_payoffs

    names, pool = pool_from(arguments)
    tracks = [as_track(track).name for track in pool.tracks]
    races = len(tracks) * len(pool.pairs) * pool.races
    with executor_from(arguments) as executor:
        announce(racing_seconds(races, pool.config.duration), cores_of(arguments))
        with open_job(arguments.out, "headroom", pool_settings(pool)) as job:
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
            print(f"written: {write_csv(lines, arguments.out / 'headroom.csv')}")
            print(f"written: {write_payoffs(tracks, payoffs, names, arguments.out / 'payoffs.csv')}")


def headroom_row(track: str, estimate: "Headroom", share: float) -> tuple[str, ...]:
    """Return the texts of a circuit: headroom, its bound, its two errors, and the transitive share."""
    errors = (estimate.opponents_error, estimate.pool_error)
    return (
        track,
        f"{estimate.value:+.3f}",
        f"{estimate.low:+.3f}",
        *(f"{error:.3f}" for error in errors),
        f"{share:.2f}",
    )


def mean_row(estimates: "Sequence[Headroom]") -> tuple[str, ...]:
    """Return the texts of the mean over circuits, whose errors are those of means over the same policies."""
    from pcs_racing_agents.payoffs.headroom import jackknife_error

    gains = np.mean([estimate.gains for estimate in estimates], axis=0)
    error = float(gains.std(ddof=1) / np.sqrt(len(gains)))
    pool = jackknife_error(np.mean([estimate.without for estimate in estimates], axis=0))
    means = (np.mean([getattr(estimate, key) for estimate in estimates]) for key in ("value", "low"))
    return ("mean", *(f"{mean:+.3f}" for mean in means), f"{error:.3f}", f"{pool:.3f}", "")


def write_payoffs(tracks: Sequence[str], payoffs: Iterable[Any], names: Sequence[str], file: Path) -> Path:
    """Write a line for each circuit and each two policies: the mean payoff over all folds, and its standard error."""
    lines: list[tuple[object, ...]] = [("track", "policy", "opponent", "payoff", "error")]
    for track, folds in zip(tracks, payoffs, strict=True):
        mean, error = folds.mean(axis=0), folds.std(axis=0, ddof=1) / np.sqrt(len(folds))
        lines += [
            (track, names[i], names[j], f"{mean[i, j]:.6f}", f"{error[i, j]:.6f}")
            for i, j in np.ndindex(mean.shape)
            if i != j
        ]
    return write_csv(lines, file)
