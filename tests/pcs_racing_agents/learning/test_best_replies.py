"""Loss to a learned best reply, in short games with a known good reply: to go faster."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import make_game
from pcs_racing.game.players import always, never_switch
from pcs_racing.race.config import PAPER, load_rules
from pcs_racing_agents import make
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.base.statistics import clustered_mean
from pcs_racing_agents.learning.best_replies import (
    BestReply,
    best_reply,
    excess_estimate,
    loss_table,
)
from pcs_racing_agents.learning.responses import load_response_settings
from pcs_racing_agents.networks import load_network
from pcs_racing_agents.tournament.race_files import race_table
from pcs_racing_agents.tournament.races import RaceRow

SMALL = load_response_settings(starts=192, rounds=1, members=1, hidden=(8,), epochs=30)


@pytest.fixture(scope="module")
def spec(archive):
    return make_game(None, archive, load_rules("paper", steps=(2.5,) * 3))


@pytest.fixture(scope="module")
def games(oval, spec):
    return [make_game(oval, spec.archive, spec.rules, stay=True, threads=1)]


def reply_to(agent, games, spec, folder, executor=None, races=1000):
    with open_job(folder, "best reply", {"agent": agent.name}) as job:
        return best_reply(games, agent, spec, SMALL, job, races=races, executor=executor)


@pytest.fixture(scope="module")
def slow(games, spec, tmp_path_factory):
    pytest.importorskip("torch", reason="torch is not installed")
    folder = tmp_path_factory.mktemp("replies") / "slow"
    return folder, reply_to(always(spec, "aggressiveness -"), games, spec, folder)


def test_an_agent_that_slows_down_loses_to_its_reply_and_an_even_score_is_no_loss(slow, games):
    _, reply = slow
    assert reply.loss.low > 0.0
    assert reply.loss.mean > 0.03
    assert len(reply.races) == reply.loss.units == 10 * 10 * 5 * 2
    excess = np.mean(reply.races.winner == 0) - np.mean(reply.races.winner == 1)
    assert reply.loss.mean == pytest.approx(0.5 * excess)
    assert not set(np.round(reply.races.start_s, 6)) & set(np.round(games[0].start_lines, 6))
    even = replace(reply.races, winner=np.tile(np.array([0, 1], np.int8), len(reply.races) // 2))
    assert excess_estimate(even).mean == 0.0


def test_a_fixed_policy_can_be_replied_to_in_enough_races(games, spec, tmp_path):
    pytest.importorskip("torch", reason="torch is not installed")
    reply = reply_to(make("pure-pursuit"), games, spec, tmp_path / "reply", races=40)
    assert set(reply.races.variants[:, 1]) == {0}
    assert len(reply.loss.clusters) == 2  # start policies of the reply, and start lines
    refused("races is 39", reply_to, never_switch(spec), games, spec, tmp_path / "few", races=39)
    assert not (tmp_path / "few" / "chunks").exists()


def test_losses_are_listed_for_each_circuit_and_for_all():
    """Races of made-up ends: on s the reply wins 2 of 4 and the agent 1, on t the agent wins both
    and crashes once.
    """
    ends = [("s", "ego", "none"), ("s", "ego", "none"), ("s", "opponent", "ego")]
    ends += [("s", "none", "none"), ("t", "opponent", "both"), ("t", "opponent", "none")]
    rows_of = [
        RaceRow(
            ego="best-reply",
            opponent="a",
            track=track,
            race=k,
            start_s=float(k),
            winner=winner,
            fault=fault,
            crash="none" if fault == "none" else "car",
            ego_variant=k % 2,
            opponent_variant=k % 2,
            duration=9.0,
            ego_path=(k % 2,),
            opponent_path=(),
        )
        for k, (track, winner, fault) in enumerate(ends)
    ]
    table = race_table(rows_of)
    reply = BestReply(None, table, excess_estimate(table))
    head, *lines = loss_table("a", reply, PAPER)
    rows = [dict(zip(head, line, strict=True)) for line in lines]
    assert [(row["track"], row["loss"]) for row in rows] == [
        ("s", "0.1250"),
        ("t", "-0.5000"),
        ("all", "-0.0833"),
    ]
    shares = ("races", "reply_won", "agent_won", "agent_own_crash")
    assert [[row[key] for key in shares] for row in rows] == [
        ["4", "0.5000", "0.2500", "0.0000"],
        ["2", "0.0000", "1.0000", "0.5000"],
        ["6", "0.3333", "0.5000", "0.1667"],
    ]
    found = [float(rows[-1][key]) for key in ("low", "high", "se")]
    assert found == pytest.approx([reply.loss.low, reply.loss.high, reply.loss.se], abs=1e-4)
    alone = BestReply(None, race_table(rows_of[:4]), None)
    assert [line[1] for line in loss_table("a", alone, PAPER)] == ["track", "s"]


def test_an_excess_is_clustered_by_policies_and_lines_without_what_policies_bring(slow):
    """By definition: where policies met in both roles, half of the difference of the two means is
    taken off.
    """

    def same(races, expected):
        found = excess_estimate(races)
        assert (found[:-1], found.clusters) == (pytest.approx(expected[:-1]), expected.clusters)

    races = slow[1].races
    ego, opponent = races.variants.T.astype(int)
    line = np.unique(races.start_s.round(4), return_inverse=True)[1]
    excess = 0.5 * (1.0 * (races.winner == 0) - (races.winner == 1))
    even = excess.copy()
    for k in range(len(races)):
        there, back = (
            (ego == one) & (opponent == other)
            for one, other in ((ego[k], opponent[k]), (opponent[k], ego[k]))
        )
        assert there.sum() == back.sum() == 10
        even[k] -= 0.5 * (excess[there].mean() - excess[back].mean())
    same(races, clustered_mean(even, ego, opponent, line, same_pool=True))
    fixed = replace(races, path=np.full_like(races.path, -1))
    same(fixed, clustered_mean(excess, ego, opponent, line, same_pool=False))
    single = replace(races, variants=races.variants * [1, 0])
    same(single, clustered_mean(excess, ego, line))
    uneven = races.take(np.arange(len(races)) > 0)
    first = (ego == ego[0]) & (opponent == opponent[0]) | (ego == opponent[0]) & (
        opponent == ego[0]
    )
    even[first] = excess[first]  # one race less in one of the directions
    parts = [part[1:] for part in (ego, opponent, line)]
    same(uneven, clustered_mean(even[1:], *parts, same_pool=True))


def test_the_command_prints_the_loss_and_writes_it(tmp_path, printed, told):
    pytest.importorskip("torch", reason="torch is not installed")
    config = tmp_path / "small.yaml"
    config.write_text("starts: 8\nrounds: 1\nmembers: 1\nhidden: [8]\nepochs: 2\n")
    out = tmp_path / "reply"
    command = ["train", "best-reply", "never-switch", "--track", "Tarnfjord", "Pipkin"]
    command += ["--duration", 2.5, "--config", config, "--out", out, "--name", "mine"]
    one = [*command, "--races"]
    text = printed(*one, 80)
    assert "learner: 8 games branched at every step" in text
    lines = (out / "best_reply.csv").read_text(encoding="utf-8").splitlines()
    rows = {row["track"]: row for row in csv.DictReader(lines)}
    assert list(rows) == ["Tarnfjord", "Pipkin", "all"]
    assert int(rows["all"]["races"]) == 80
    assert rows["all"]["loss"] in text
    assert (out / "results.csv").is_file()
    assert text.endswith(f"race it as response:network={out / 'agent'}\n")
    assert load_network(out / "agent").name == "mine"
    assert "races" in told(*one, 81)  # another run
    assert "races is 79" in told(*one, 79)
