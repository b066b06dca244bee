"""Loss to a learned best reply, in short games in which a good reply is known: to go faster."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from refusal import refused

from pcs_racing import make_game
from pcs_racing.game.config import load_game_config
from pcs_racing.game.players import always, never_switch
from pcs_racing_agents import make
from pcs_racing_agents.agents.game_spec import make_game_spec
from pcs_racing_agents.base.executors import make_executor
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.base.statistics import clustered_mean
from pcs_racing_agents.learning.responses import (
    BestReply,
    best_reply,
    kept_networks,
    load_response_settings,
    reply_text,
    write_reply,
)
from pcs_racing_agents.learning.responses.best_reply import excess_estimate
from pcs_racing_agents.networks import load_network
from pcs_racing_agents.tournament.race_files import race_table
from pcs_racing_agents.tournament.races import RaceRow

SMALL = load_response_settings(starts=192, rounds=1, members=1, hidden=(8,), epochs=30, patience=8)


@pytest.fixture(scope="module")
def spec(archive):
    return make_game_spec(archive, load_game_config("paper", moves=2, step_seconds=2.5))


@pytest.fixture(scope="module")
def games(oval, spec):
    return [make_game(oval, spec.archive, spec.config, stay=True, threads=1)]


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


def test_a_run_that_goes_on_elsewhere_gives_the_same_and_trains_nothing_again(
    slow, games, spec, monkeypatch
):
    folder, first = slow
    for file in sorted((folder / "chunks").glob("*.npz"))[::2]:
        file.unlink()
    with make_executor("threads", 2) as executor:
        again = reply_to(always(spec, "aggressiveness -"), games, spec, folder, executor)
    assert again.loss == first.loss
    for own, others in zip(first.network.layers.weights, again.network.layers.weights, strict=True):
        np.testing.assert_array_equal(own, others)

    # A run that goes on does not train again what is there.
    def never(*arguments, **options):
        raise AssertionError("trained again")

    monkeypatch.setattr(kept_networks, "train_network", never)
    assert reply_to(always(spec, "aggressiveness -"), games, spec, folder).loss == first.loss


def test_a_fixed_policy_can_be_replied_to_in_enough_races(games, spec, tmp_path):
    pytest.importorskip("torch", reason="torch is not installed")
    reply = reply_to(make("pure-pursuit"), games, spec, tmp_path / "reply", races=40)
    assert set(reply.races.variants[:, 1]) == {0}
    assert len(reply.loss.clusters) == 2  # start policies of the reply, and start lines
    refused("races is 39", reply_to, never_switch(spec), games, spec, tmp_path / "few", races=39)
    assert not (tmp_path / "few" / "chunks").exists()


def test_losses_are_told_for_each_circuit_and_for_all(tmp_path):
    """Races of made-up ends: on s the reply wins 2 of 4 and the agent 1, on t the agent wins both
    and crashes once.
    """
    ends = [("s", "ego", "none"), ("s", "ego", "none"), ("s", "opponent", "ego")]
    ends += [("s", "none", "none"), ("t", "opponent", "both"), ("t", "opponent", "none")]
    rows = [
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
    table = race_table(rows)
    reply = BestReply(None, table, excess_estimate(table))
    lines = reply_text("a", reply, SMALL).splitlines()
    assert [line.split()[:3] for line in lines[1:4]] == [
        ["a", "s", "+0.125"],
        ["a", "t", "-0.500"],
        ["a", "all", "-0.083"],
    ]
    assert [line.split()[-4:] for line in lines[1:4]] == [
        ["4", "0.500", "0.250", "0.0%"],
        ["2", "0.000", "1.000", "50.0%"],
        ["6", "0.333", "0.500", "16.7%"],
    ]
    assert lines[-1].startswith("learner: 192 games branched at every step and on each circuit, 1")
    written = write_reply("a", reply, tmp_path).read_text().splitlines()
    whole = dict(zip(*csv.reader([written[0], written[-1]]), strict=True))
    assert (whole["agent"], whole["track"], whole["races"]) == ("a", "all", "6")
    assert [float(whole[key]) for key in ("loss", "low", "high", "se")] == pytest.approx(
        [reply.loss.mean, reply.loss.low, reply.loss.high, reply.loss.se], rel=1e-5
    )
    assert [float(whole[key]) for key in ("reply_won", "agent_won", "agent_own_crash")] == (
        pytest.approx([2 / 6, 0.5, 1 / 6], rel=1e-5)
    )
    alone = BestReply(None, race_table(rows[:4]), None)
    assert "all" not in reply_text("a", alone, SMALL)


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
    command = ["learn", "best-reply", "--track", "Tarnfjord", "Pipkin", "--duration", 2.5]
    command += ["--config", config, "--out", out, "--name", "mine"]
    one = [*command, "--pool", "never-switch", "--races"]
    text = printed(*one, 80)
    assert "learner: 8 games branched at every step" in text
    lines = (out / "best_reply.csv").read_text(encoding="utf-8").splitlines()
    rows = {row["track"]: row for row in csv.DictReader(lines)}
    assert list(rows) == ["Tarnfjord", "Pipkin", "all"]
    assert int(rows["all"]["races"]) == 80
    assert f"{float(rows['all']['loss']):+.3f}" in text
    assert (out / "results.csv").is_file()
    assert text.endswith(f"race it as response:network={out / 'agent'}\n")
    assert load_network(out / "agent").name == "mine"
    assert "races" in told(*one, 81)  # another run
    assert "races is 79" in told(*one, 79)
    assert "against one agent; --pool names 2" in told(*command)
