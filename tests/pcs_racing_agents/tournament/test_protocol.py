"""A protocol: the same races for every agent, a table of scores, and hashes of its inputs."""

import numpy as np
import pytest
import yaml
from refusal import refused
from repository import load_tool
from zoo_games import toy_archive

from pcs_racing.base.settings import plain_settings
from pcs_racing.game.archive_files import save_archive
from pcs_racing_agents.cli.main import main
from pcs_racing_agents.study.study import open_results
from pcs_racing_agents.tournament import ProtocolConfig, load_protocol, play_protocol
from pcs_racing_agents.tournament.protocol import protocol_scores

AGENTS = ["never-switch", "random-moves", "pure-pursuit"]


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    archive = save_archive(toy_archive(), tmp_path_factory.mktemp("protocol") / "toy")
    return ProtocolConfig(
        name="toy-v1",
        archive=str(archive),
        rules="paper",
        train=("Pipkin",),
        test=("Larkmoor",),
        opponents=("random-moves", "lattice:pace=0.4"),
        races=4,
    )


@pytest.fixture(scope="module")
def protocol(config):
    return load_protocol(config, AGENTS)


@pytest.fixture(scope="module")
def races(protocol):
    return play_protocol(protocol)


def test_every_agent_drives_the_same_races_against_every_opponent(races):
    rows = list(races)
    for name in AGENTS:
        met = [(row.track, row.opponent, row.race) for row in rows if row.ego == name]
        assert set(met) == {
            (track, opponent, race)
            for track in ("Pipkin", "Larkmoor")
            for opponent in ("random-moves", "lattice:pace=0.4")
            for race in range(4)
        }
        assert len(met) == 16
    starts = {(row.track, row.race): (row.start_s, row.side) for row in rows}
    assert all(starts[row.track, row.race] == (row.start_s, row.side) for row in rows)


def test_scores_are_means_over_the_races_and_gains_are_over_the_first_agent(protocol, races):
    rows = list(races)
    scores = protocol_scores(protocol, races)
    means = [one.score.mean for one in scores]
    assert means == sorted(means, reverse=True)
    won = {"ego": 1.0, "opponent": 0.0}

    def mean(name, *tracks):
        return np.mean(
            [
                won.get(row.winner, 0.5 * (row.crash == "none"))
                for row in rows
                if row.ego == name and row.track in tracks
            ]
        )

    for one in scores:
        own = [row for row in rows if row.ego == one.agent]
        assert one.score.mean == pytest.approx(mean(one.agent, "Pipkin", "Larkmoor"))
        assert one.train == pytest.approx(mean(one.agent, "Pipkin"))
        assert one.test == pytest.approx(mean(one.agent, "Larkmoor"))
        crashed = np.mean([row.crash != "none" for row in own])
        assert one.score.own_crash + one.score.other_crash == pytest.approx(crashed)
        gain = one.score.mean - mean(AGENTS[0], "Pipkin", "Larkmoor")
        assert one.gain.partition(" ")[0] == ("" if one.agent == AGENTS[0] else f"{gain:+.3f}")


def test_a_protocol_with_other_hashes_is_refused_and_a_pinned_one_is_read(config, tmp_path):
    file = tmp_path / "protocol.yaml"
    values = {name: value for name, value in plain_settings(config).items() if name != "hashes"}
    file.write_text(f"{yaml.safe_dump(values)}hashes:\n- archive toy 0\n")
    refused("was written for 'archive toy 0', but", load_protocol, str(file), AGENTS)
    load_tool("pin_protocol").pin_hashes(file)
    pinned = load_protocol(str(file), AGENTS)
    assert pinned.config.hashes == pinned.hashes
    assert pinned.content_hash == load_protocol(config, AGENTS[:1]).content_hash


def test_this_installation_has_the_hashes_of_the_shipped_protocol():
    assert load_protocol("bench-v4", ["best-fixed"]).config.hashes


def test_the_command_prints_a_table_and_writes_races_that_can_be_driven_again(
    config, tmp_path, capsys
):
    file = tmp_path / "protocol.yaml"
    file.write_text(str(plain_settings(config)))
    words = ["tournament", "--protocol", str(file), "--agents", *AGENTS[:2]]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    assert "over never-switch" in capsys.readouterr().out
    results = open_results(tmp_path / "out")
    row = results.row(len(results.races) - 1)
    pairing = results.pairing(row)
    (again,) = pairing.take([row.race]).race([pairing.ego])
    results.check_lead(len(results.races) - 1, again["lead"][0])
    for wrong in (["--races", "6"], ["--track", "Pipkin"], ["--rules", "contest"]):
        assert main([*words, *wrong]) == 2
        assert "a protocol fixes tracks" in capsys.readouterr().err
