"""The benchmark on a small protocol: races, scores, cards, and the leaderboard."""

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from refusal import refused
from repository import REPOSITORY, load_tool
from zoo_games import toy_archive

from pcs_racing.game.archive_files import save_archive
from pcs_racing_agents.agents import make
from pcs_racing_agents.agents.zoo import load_entrant
from pcs_racing_agents.benchmark.card import (
    Card,
    CardScore,
    Gain,
    board_page,
    board_rows,
    read_card,
    read_cards,
    write_card,
)
from pcs_racing_agents.benchmark.protocol import KINDS, ProtocolConfig, load_protocol
from pcs_racing_agents.benchmark.scoring import (
    decision_cost,
    gain,
    play_protocol,
    summarise,
)
from pcs_racing_agents.cli.main import main

SMALL = {
    "race": "paper",
    "archive": "default",
    "train": ("Pipkin",),
    "test": ("Larkmoor",),
    "keeps": ("never-switch",),
    "switches": ("random-moves",),
    "planners": ("pure-pursuit",),
    "agents": ("always-restraint+",),
    "blind": ("never-switch",),
    "egos": 2,
    "variants": 2,
}


@pytest.fixture(scope="module")
def protocol():
    return load_protocol(ProtocolConfig(**SMALL))


@pytest.fixture(scope="module")
def results(protocol):
    return play_protocol(protocol, [make("random-moves", archive="default")])


def test_every_opponent_is_met_on_every_circuit_by_every_arm(protocol, results):
    cells = list(protocol.cells)
    assert {(cell.circuit, cell.kind) for cell in cells} == {
        (c, k) for c in ("Pipkin", "Larkmoor") for k in KINDS
    }
    assert list(results) == ["random-moves", "never-switch"]
    for races in results.values():
        assert [one.cell for one in races] == cells
        # also against a planner, which has one policy
        assert {len(one.races) for one in races} == {2 * 2 * 2}
    for own, blind in zip(*results.values(), strict=True):
        np.testing.assert_array_equal(own.races.start_s, blind.races.start_s)
        np.testing.assert_array_equal(own.races.variants, blind.races.variants)


def test_scores_and_gains_are_means_over_the_same_races(results):
    own, blind = (
        {circuits: [one.races for one in races if circuits in ("all", one.cell.circuit)]
         for circuits in ("all", "Pipkin", "Larkmoor")}
        for races in results.values()
    )  # fmt: skip
    scores = {(score.part, score.circuits): score for score in summarise(results["random-moves"])}
    for named, circuits in (("all", "all"), ("train", "Pipkin"), ("test", "Larkmoor")):
        mean, other = (
            np.concatenate([one.score for one in races[circuits]]).mean() for races in (own, blind)
        )
        crashed = np.concatenate([one.crashed for one in own[circuits]])
        found = scores["all", named]
        assert (found.score, found.races) == (pytest.approx(mean), len(crashed))
        assert found.own_crash + found.other_crash == pytest.approx(crashed.mean())
        gained = gain(results, "random-moves", named)
        assert (gained.over, gained.gain) == ("never-switch", pytest.approx(mean - other))
        assert gained.low <= gained.gain <= gained.high
    cell, _, races = results["random-moves"][0]
    assert scores[cell.opponent, cell.circuit].score == pytest.approx(races.score.mean())


def test_a_protocol_of_another_installation_is_refused(protocol):
    kept = ProtocolConfig(**SMALL, hashes=protocol.hashes)
    assert load_protocol(kept).content_hash == protocol.content_hash
    changed = ProtocolConfig(**SMALL, hashes=(protocol.hashes[0][:-1] + "x", *protocol.hashes[1:]))
    refused("archive default", load_protocol, changed)


def test_the_cards_of_the_leaderboard_belong_to_the_shipped_protocol():
    cards = read_cards([REPOSITORY / "studies" / "bench_v3"])
    assert len({card.protocol_sha256 for card in cards}) == 1


def test_a_decision_is_timed_as_often_as_asked_for_and_costs_a_fixed_policy_nothing(protocol):
    asked = []
    agent = SimpleNamespace(act=lambda observations, turn: asked.append(len(observations)))
    assert decision_cost(protocol, agent, repeats=3) > 0.0
    assert asked == [1, 1, 1]
    assert decision_cost(protocol, make("lattice:pace=0.4")) is None


def test_entrants_of_several_kinds(protocol, tmp_path, monkeypatch):
    """A module is found in the working directory, too."""
    (tmp_path / "brought.py").write_text(
        "from pcs_racing.game.competitor import SameMove\n"
        "def agent(spec, weights=None):\n"
        "    return SameMove('mine' if weights is None else weights.name, 1)\n"
    )
    (tmp_path / "net.pt").write_bytes(b"")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", sys.path[:])
    assert load_entrant("never-switch", protocol.spec).name == "never-switch"
    assert load_entrant("brought:agent", protocol.spec).name == "brought:agent"
    assert (
        load_entrant("brought:agent", protocol.spec, weights=tmp_path / "net.pt", name="x").name
        == "x"
    )
    assert load_entrant("lattice:pace=0.4", protocol.spec).name == "lattice:pace=0.4"
    assert load_entrant("ppo-drive", protocol.spec).planner.name == "ppo-drive"
    folder = str(REPOSITORY / "pcs_racing" / "data" / "planners" / "ppo-drive")
    assert load_entrant(folder, protocol.spec, name="mine").name == "mine"
    for text in ("brought:nothing", "nobody", "gone.zip"):
        refused(text, load_entrant, text, protocol.spec)


# Cards


def card(name="mine", score=0.5, **changes):
    parts = (("all", "all"), ("all", "train"), ("all", "test"), ("keeps", "train"))
    scores = tuple(
        CardScore(*part, 10 + k, score, score - 0.1, score + 0.1, 0.1, 0.0)
        for k, part in enumerate(parts)
    )
    gains = {"all": Gain("best-fixed", 0.1, 0.0, 0.2)}
    hashes = {"protocol_sha256": "ab" * 32, "agent_sha256": "cd" * 32}
    return Card(
        **{"protocol": "p-v1", "agent": name, **hashes, "gains": gains, "scores": scores, **changes}
    )


def test_a_card_comes_back_as_it_was_written_and_a_damaged_one_is_refused(tmp_path):
    written = card("<b>mine</b>", cost_us=3.5)
    assert [path.name for path in write_card(written, tmp_path)] == ["card.json", "card.html"]
    assert read_card(tmp_path) == written
    assert written.score("keeps", "train").races == 13
    refused("no score of 'keeps' on 'test' circuits", written.score, "keeps", "test")
    page = (tmp_path / "card.html").read_text()
    assert "<b>mine" not in page
    assert "&lt;b&gt;mine" in page
    for text in ["", "[]", "{}", '{"format": "pcs-racing card 1"}', '{"format": "other"}']:
        (tmp_path / "card.json").write_text(text)
        refused(r"card\.json", read_card, tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        *[
            ({"score": value}, "score is .*from 0 to 1")
            for value in (5.0, -0.1, "1", None, True, [0.5])
        ],
        ({"score": float("nan")}, "NaN.*finite"),
        ({"score": float("inf")}, "Infinity.*finite"),
        ({"score": 0.9}, "score is 0.9, outside of its interval"),
        *[({"own_crash": value}, "own_crash is") for value in (-5, 1.01, {})],
        *[({"races": value}, "races is") for value in ([], 0, 2.5, 10**400)],
        *[({"agent": value}, "name is") for value in (None, "", "a" * 201, "a\x1b[2J", 7, [])],
        *[({"agent_sha256": value}, "hash is") for value in ("c", "AB" * 32, 64 * "g", None)],
        *[({"scores": value}, "scores are") for value in (None, [], {}, 3)],
        ({"scores": [[]]}, "must be a mapping of part"),
        ({"gains": {"mine": {}}}, "gains are"),
        ({"gains": {"all": {"gain": 0.1}}}, "must be a mapping of over"),
        *[({"cost_us": value}, "cost_us is") for value in (-1.0, 1e308)],
        ({"page": "x"}, "damaged card"),
    ],
)
def test_no_value_of_a_strangers_card_is_believed(change, message, tmp_path):
    write_card(card(), tmp_path)
    values = json.loads((tmp_path / "card.json").read_text())
    ((key, value),) = change.items()
    (values["scores"][0] if key in values["scores"][0] else values)[key] = value
    (tmp_path / "card.json").write_text(json.dumps(values))
    refused(message, read_card, tmp_path)


@pytest.mark.parametrize(
    "text", ["[" * 200_000, '{"a": ' * 200_000, "9" * 5000, "1e999", "-Infinity", "\ud800", "1 2"]
)
def test_what_is_no_json_is_no_card(text, tmp_path):
    (tmp_path / "card.json").write_text(text, "utf-8", "surrogatepass")
    refused(r"card\.json", read_card, tmp_path)


def test_the_leaderboard_ranks_cards_of_one_protocol(tmp_path):
    def folder(name, value):
        (tmp_path / name).mkdir()
        write_card(value, tmp_path / name)
        return tmp_path / name

    good = [folder("a", card("a", 0.3)), folder("b", card("b", 0.6))]
    cards = read_cards(good)
    assert [row[0] for row in board_rows(cards)] == ["agent", "b", "a"]
    assert "p-v1" in board_page(cards)
    (tmp_path / "files").mkdir()
    for place in good:
        shutil.copyfile(place / "card.json", tmp_path / "files" / f"{place.name}.json")
    assert read_cards([tmp_path / "files"]) == cards
    others = {
        "v2": card("c", protocol="p-v2"),
        "hash": card("d", protocol_sha256="0" * 64),
        "twice": card("a"),
    }
    for name, value in others.items():
        refused(name, read_cards, [*good, folder(name, value)])


@pytest.fixture(scope="module")
def protocol_file(tmp_path_factory) -> str:
    """A protocol with the toy archive, as a file for the command."""
    folder = tmp_path_factory.mktemp("protocol")
    save_archive(toy_archive(), folder / "toy")
    settings = {
        key: list(value) if isinstance(value, tuple) else value for key, value in SMALL.items()
    }
    file = folder / "protocol.yaml"
    file.write_text(
        json.dumps({**settings, "archive": str(folder / "toy"), "agents": ["random-moves"]})
    )
    return str(file)


def test_the_command_writes_cards_that_the_leaderboard_takes(protocol_file, tmp_path, capsys):
    def benchmark(*arguments: str, out: str) -> int:
        return main(
            [
                "benchmark",
                "card",
                *arguments,
                "--protocol",
                protocol_file,
                "--out",
                str(tmp_path / out),
            ]
        )

    assert benchmark("always-restraint+", out="card") == 0
    assert "Adaptivity gain over the best baseline (never-switch)" in capsys.readouterr().out
    both = ["always-restraint+", "pure-pursuit"]
    assert benchmark(*both, out="two") == 0
    one, two = read_card(tmp_path / "card"), read_card(tmp_path / "two" / both[0])
    # an agent drives the same races alone and beside others
    assert replace(two, cost_us=one.cost_us) == one
    card = read_card(tmp_path / "two" / "pure-pursuit")
    assert card.score().races == one.score().races  # one policy, so more start lines
    assert card.gains == {}  # on other races than those of the baseline
    capsys.readouterr()
    assert (
        main(["benchmark", "leaderboard", str(tmp_path / "two"), "--out", str(tmp_path / "board")])
        == 0
    )
    board = capsys.readouterr().out
    assert all(name in board for name in both)
    assert (tmp_path / "board" / "leaderboard.html").is_file()
    for wrong in (both[:1] * 2, [*both, "--name", "mine"], ["nobody"]):
        assert benchmark(*wrong, out="none") == 2
    assert not (tmp_path / "none" / "card.json").exists()


def test_the_cards_of_the_leaderboard_are_of_all_shipped_agents_and_of_pinned_inputs(
    protocol_file, tmp_path, monkeypatch
):
    cards = load_tool("cards")
    file = tmp_path / "protocol.yaml"
    settings = json.loads(Path(protocol_file).read_text())
    file.write_text(f"{yaml.safe_dump(settings)}hashes:\n- archive toy 0\n")
    refused("written for 'archive toy 0'", load_protocol, str(file))
    monkeypatch.setattr(cards, "PROTOCOL", file)
    cards.pin_hashes()
    protocol = load_protocol(str(file))
    assert protocol.config.hashes == protocol.hashes
    untrained = ["never-switch", "random-moves", "random-policy", "lane-switcher"]
    assert cards.shipped_agents(protocol) == untrained
