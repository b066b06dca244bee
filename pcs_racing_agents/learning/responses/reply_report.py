"""Losses to learned best replies as text and as a file."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pcs_racing_agents.learning.responses.best_reply import BestReply, excess_estimate
from pcs_racing_agents.learning.responses.learner import ResponseSettings
from pcs_racing_agents.results.csv_files import write_csv
from pcs_racing_agents.results.races import RaceTable
from pcs_racing_agents.results.text_table import aligned, interval_text
from pcs_racing_agents.tournament.statistics import Estimate

ALL = "all"
REPLY_HEAD = ("agent", "circuit", "loss", "95 % interval", "races", "reply won", "agent won", "agent's own crashes")
REPLY_NOTE = """loss: half of the reply's wins minus the agent's, as a share of the races; 0.1 means that the reply
won 60 of 100 races. It is a lower bound: a learner with a larger budget may find a better reply. The interval is robust
to clusters of start policies and start lines."""
COLUMNS = ("agent", "track", "loss", "low", "high", "se", "df", "races", "reply_won", "agent_won", "agent_own_crash")


def reply_text(replies: Mapping[str, BestReply], settings: ResponseSettings) -> str:
    """Return the table of the losses of several agents, with the learner's budget."""
    budget = (
        f"learner: {settings.starts} games branched at every step and on each circuit, {settings.rounds} rounds, "
        f"{settings.members} networks"
    )
    return "\n".join([*aligned([REPLY_HEAD, *reply_rows(replies)]), "", REPLY_NOTE, budget])


def reply_rows(replies: Mapping[str, BestReply]) -> list[tuple[str, ...]]:
    """Return the lines of the table: each agent on each circuit, and on all if there are several."""
    rows: list[tuple[str, ...]] = []
    for agent, reply in replies.items():
        for track, races, loss in _by_track(reply):
            won, lost = np.mean(races.winner == 0), np.mean(races.winner == 1)
            rows.append(
                (
                    agent,
                    track,
                    f"{loss.mean:+.3f}",
                    interval_text(loss.low, loss.high),
                    str(loss.units),
                    f"{won:.3f}",
                    f"{lost:.3f}",
                    f"{np.mean(races.fault[:, 1] > 0):.1%}",
                )
            )
    return rows


def write_replies(replies: Mapping[str, BestReply], path: Path) -> Path:
    """Write a line for each agent and circuit as CSV, and one for all circuits if there are several."""
    lines: list[tuple[object, ...]] = [COLUMNS]
    for agent, reply in replies.items():
        for track, races, loss in _by_track(reply):
            shares = np.mean(races.winner == 0), np.mean(races.winner == 1), np.mean(races.fault[:, 1] > 0)
            numbers = [f"{value:.6g}" for value in (loss.mean, loss.low, loss.high, loss.se)]
            lines.append((agent, track, *numbers, loss.df, loss.units, *(f"{share:.6g}" for share in shares)))
    return write_csv(lines, path)


def _by_track(reply: BestReply) -> list[tuple[str, RaceTable, Estimate]]:
    words, codes = reply.races.track
    parts = [(word, reply.races.take(codes == code)) for code, word in enumerate(words)]
    rows = [(word, races, excess_estimate(races)) for word, races in parts]
    return rows if len(rows) == 1 else [*rows, (ALL, reply.races, reply.loss)]
