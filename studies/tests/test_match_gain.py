"""Matches for a report: what is learned from training races, and what remembering it gains."""

import csv

import numpy as np
import pytest
from zoo_games import CONFIG, toy_archive

from pcs_racing import load_track
from pcs_racing.envs.match import MatchEnv
from pcs_racing.game.archive_files import save_archive
from pcs_racing.game.match import MatchGame
from pcs_racing.game.rules import RaceGame
from pcs_racing_agents.agents import make_game_spec
from studies.__main__ import main
from studies.matches.behaviours import Behaviours
from studies.matches.gain import ARMS, MatchTest, TrackGain, gain_text, match_gains
from studies.matches.learning import LearningRaces, learn_behaviours
from studies.matches.play import FixedChoice, play_matches


@pytest.fixture(scope="module")
def small():
    return make_game_spec(toy_archive(4), CONFIG)


@pytest.fixture(scope="module")
def table(small, oval) -> Behaviours:
    return learn_behaviours(LearningRaces(small, (oval,), races=8, seed=3))


@pytest.fixture(scope="module")
def gains(small, table, oval) -> list[TrackGain]:
    return match_gains(
        MatchTest(small, table, (oval, load_track("Pipkin")), races=2, matches=4, seed=1)
    )


def test_what_is_learned(table):
    assert table.scores.shape == (4, 4)
    assert table.seen.shape == (4, 4, 4)
    # A race has one winner, or a tie, or a crash that pays nobody.
    assert (table.scores + table.scores.T <= 1.0 + 1e-9).all()
    assert (np.diff(table.scores.mean(axis=1)) > 0.0).any()  # the policies are sorted by pace
    lead = table.seen[:, :, -2]
    np.testing.assert_allclose(lead, -lead.T, atol=1e-6)
    assert table.training == {"tracks": "oval", "races": 8, "seed": 3}


def test_all_players_drive_the_same_first_race(gains):
    """Before the first race nobody but the one who is told knows anything."""
    assert [gain.track for gain in gains] == ["oval", "Pipkin"]
    assert [gain.learned for gain in gains] == [True, False]
    for gain in gains:
        assert gain.scores.shape == (len(ARMS), 4, 4, 2)
        assert gain.gain_by_race("remember")[0] == 0.0
        assert gain.gain_by_race("nearest")[0] == 0.0
        assert np.isin(gain.scores, (0.0, 0.5, 1.0)).all()


def test_a_gain_is_what_was_put_in():
    """Against two of three rivals it wins 1/2 more from the second race on: 1/3 of the races there,
    1/6 of all.
    """
    scores = np.zeros((len(ARMS), 3, 4, 2))
    scores[ARMS.index("remember"), :2, ::2, 1] = 1.0
    gain = TrackGain("nowhere", True, scores)
    assert gain.gain("remember").mean == pytest.approx(1.0 / 6.0)
    assert gain.gain("remember").low < 0.0 < gain.gain("known").mean + 0.1
    np.testing.assert_allclose(gain.gain_by_race("remember"), [0.0, 1.0 / 3.0])
    assert "+0.167" in gain_text([gain])
    assert gain_text([gain, gain]).count("+0.167") == 3  # two circuits and their mean


def test_the_runner_plays_the_matches_of_the_environment(small, oval):
    env = MatchEnv(
        track=oval, archive=small.archive, race=small.config, opponent="always-aggressiveness +"
    )
    env.reset(seed=5)
    key = np.random.default_rng(5).integers(2**63)  # what the environment draws first
    game = RaceGame(oval, small.archive, small.config)
    opponent = env.opponents[0].competitor
    played = play_matches(
        MatchGame(game),
        FixedChoice(1),
        opponent,
        keys=np.array([key], np.uint64),
        policies=(-1, -1),
    )
    rewards = [env.step(1)[1] for _ in range(3)]
    assert played.scores[0, 0].tolist() == rewards
    np.testing.assert_array_equal(played.observations[0, 0], env.batch.seen[0, 0])
    assert played.policy[0, 0].tolist() == [1, 1, 1]


def test_the_command_writes_what_it_prints(tmp_path, capsys):
    archive = save_archive(toy_archive(3), tmp_path / "archive")
    out = tmp_path / "match"
    short = ["--duration", "4", "--races", "2", "--matches", "2", "--learning-races", "4"]
    command = [
        "match",
        "--archive",
        str(archive),
        "--track",
        "Pipkin",
        "--test-track",
        "Tarnfjord",
        *short,
    ]
    assert main([*command, "--out", str(out)]) == 0
    assert "the best fixed policy is toy[" in capsys.readouterr().out
    assert (out / "behaviours" / "manifest.yaml").is_file()
    with open(out / "matches.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 3 * 2
    assert {row["learned"] for row in rows if row["track"] == "Tarnfjord"} == {"0"}
    assert all(0.0 <= float(row[arm]) <= 1.0 for row in rows for arm in ARMS)
