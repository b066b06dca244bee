"""The curve of gain against loss: what robust responses win against a pool, and what they lose to best replies."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcs_racing.base.checks import check_number
from pcs_racing.base.errors import InputError
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents.agent import Competitor
from pcs_racing_agents.agents.mixture import from_network_set
from pcs_racing_agents.agents.setting import Setting
from pcs_racing_agents.base.jobs import Job
from pcs_racing_agents.base.progress import Progress
from pcs_racing_agents.base.style import COLOURS, SOFT, new_figure, picture, tidy
from pcs_racing_agents.base.tables import aligned, interval_text, write_csv
from pcs_racing_agents.learning.responses.best_reply import best_reply, race_on_circuits
from pcs_racing_agents.learning.responses.learner import ResponseSettings
from pcs_racing_agents.learning.robust import RobustSettings, learn_robust
from pcs_racing_agents.networks import NetworkSet
from pcs_racing_agents.tournament.races import RaceTable
from pcs_racing_agents.tournament.statistics import Estimate, clustered_mean


class CurvePoint(NamedTuple):
    """A robust response on the curve."""

    pool_share: float  #: p: the share of its training games against the pool.
    gain: Estimate  #: Its score against the pool minus that of the baseline in the same races.
    loss: Estimate  #: What it loses to a learned best reply (:func:`pcs_racing_agents.learning.responses.best_reply`).
    networks: NetworkSet


def robust_curve(
    games: Sequence[RaceGame],
    pool: Sequence[Competitor],
    baseline: Competitor,
    setting: Setting,
    settings: RobustSettings,
    reply_settings: ResponseSettings,
    job: Job,
    *,
    pool_shares: Sequence[float] = (0.0, 0.5, 0.75, 0.9, 1.0),
    races: int = 4000,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> list[CurvePoint]:
    """Learn a robust response for each of several shares, and measure gain and loss of each.

    Parameters
    ----------
    games, pool, setting, settings
        As for :func:`pcs_racing_agents.learning.robust.learn_robust`; the settings' own share is not used.
    baseline : Competitor
        The gain is over this agent, in the same races.
    reply_settings : ResponseSettings
        Budget and seed of the best replies.
    job : Job
        Stores branches, networks and races. Its settings must identify pool and baseline.
    pool_shares : sequence of float
        Different, each from 0 to 1.
    races : int
        About how many against each opponent of the pool, and against each best reply.
    """
    shares = check_shares(pool_shares)

    def against_pool(agent: Competitor, label: str) -> list[RaceTable]:
        return [
            race_on_circuits(
                games,
                agent,
                opponent,
                races,
                settings.seed + i,
                job,
                name=f"{label}-pool-{i}",
                executor=executor,
                progress=progress,
            )
            for i, opponent in enumerate(pool)
        ]

    base = against_pool(baseline, "baseline")
    points = []
    for share in shares:
        label = f"p{round(1e6 * share)}"
        networks = learn_robust(
            games,
            pool,
            setting,
            replace(settings, pool_share=share),
            job,
            name=f"robust-{share:g}",
            part=f"{label}-",
            executor=executor,
            progress=progress,
        )
        agent = from_network_set(setting, name=networks.name, seed=settings.seed, kind="robust", networks=networks)
        gain = gain_over(against_pool(agent, label), base)
        reply = best_reply(
            games,
            agent,
            setting,
            reply_settings,
            job,
            races=races,
            part=f"{label}-",
            executor=executor,
            progress=progress,
        )
        points.append(CurvePoint(share, gain, reply.loss, networks))
    return points


def check_shares(shares: Sequence[float]) -> list[float]:
    """Check shares of the pool: numbers from 0 to 1, each once."""
    checked = [check_number("a share of the pool", share, 0.0, 1.0) for share in shares]
    if not checked or len(set(checked)) < len(checked):
        raise InputError(f"the shares of the pool are {list(shares)}; give at least one, each once")
    return checked


def gain_over(races: Sequence[RaceTable], baseline: Sequence[RaceTable]) -> Estimate:
    """Return the mean difference of score between an agent and a baseline that drove the same races.

    Parameters
    ----------
    races, baseline : sequence of RaceTable
        One for each opponent, race by race in the same order.
    """
    for own, other in zip(races, baseline, strict=True):
        for column in ("variants", "start_s", "side"):
            if not np.array_equal(getattr(own, column), getattr(other, column)):
                raise InputError(f"agent and baseline did not drive the same races: {column} differs")
    difference = np.concatenate([own.score - other.score for own, other in zip(races, baseline, strict=True)])
    ego = np.concatenate([table.variants[:, 0].astype(np.int64) for table in races])
    # Variants of different opponents are different, and so are start lines of different circuits.
    opponent = np.concatenate([1000 * i + table.variants[:, 1].astype(np.int64) for i, table in enumerate(races)])
    codes = np.concatenate([table.track.codes.astype(np.float64) for table in races])
    place = np.stack([codes, np.concatenate([table.start_s for table in races]).round(4)], axis=1)
    line = np.unique(place, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    kinds = [ego, line] if len(np.unique(opponent)) == 1 else [ego, opponent, line]
    return clustered_mean(difference, *kinds)


HEAD = ("p", "gain", "95 % interval", "loss", "95 % interval", "races", "networks")
COLUMNS = ("pool_share", "gain", "gain_low", "gain_high", "loss", "loss_low", "loss_high", "races", "networks")
NOTE = """p: share of the training games against the pool, the others against learned adversaries; gain: score against
the pool minus that of {baseline} in the same races; loss: to a best reply that was learned against the agent"""


def curve_text(points: Sequence[CurvePoint], baseline: str) -> str:
    """Return the table of a curve, with the meaning of its columns."""
    rows = [
        (
            f"{point.pool_share:g}",
            f"{point.gain.mean:+.3f}",
            interval_text(point.gain.low, point.gain.high),
            f"{point.loss.mean:+.3f}",
            interval_text(point.loss.low, point.loss.high),
            str(point.gain.units),
            str(len(point.networks.networks)),
        )
        for point in points
    ]
    return "\n".join([*aligned([HEAD, *rows]), "", NOTE.format(baseline=baseline)])


def write_curve(points: Sequence[CurvePoint], path: Path) -> Path:
    """Write a line for each share as CSV."""
    lines: list[tuple[object, ...]] = [COLUMNS]
    for point in points:
        numbers = (point.pool_share, *point.gain[:3], *point.loss[:3])
        lines.append((*(f"{value:.6g}" for value in numbers), point.gain.units, len(point.networks.networks)))
    return write_csv(lines, path)


@picture
def curve_picture(points: Sequence[CurvePoint], baseline: str) -> Any:
    """Draw the gain over the loss, with the intervals of both; each point is named by its share p."""
    figure = new_figure(6.4, 4.4)
    axes = figure.subplots()
    along = sorted(points, key=lambda point: point.pool_share)
    axes.plot([point.loss.mean for point in along], [point.gain.mean for point in along], color=SOFT, lw=0.9, zorder=1)
    for number, point in enumerate(along):
        x, y = point.loss.mean, point.gain.mean
        axes.plot([point.loss.low, point.loss.high], [y, y], color=COLOURS[0], lw=1.2)
        axes.plot([x, x], [point.gain.low, point.gain.high], color=COLOURS[0], lw=1.2)
        axes.plot(x, y, "o", color=COLOURS[0], ms=6)
        # Neighbours have their labels on different sides: points of large shares often lie close together.
        where = {"xytext": (7, -13)} if number % 2 == 0 else {"xytext": (-7, 7), "ha": "right"}
        axes.annotate(f"p = {point.pool_share:g}", (x, y), textcoords="offset points", fontsize=8.5, **where)
    axes.axhline(0.0, color=SOFT, lw=0.7)
    axes.axvline(0.0, color=SOFT, lw=0.7)
    axes.set_xlabel("loss to a learned best reply, races won; left: harder to exploit")
    axes.set_ylabel(f"gain over {baseline} against the pool, races won")
    axes.set_title("lines: 95 % intervals")
    tidy(axes)
    return figure
