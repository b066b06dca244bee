"""Estimates are counts of work times measured rates; what is tested here is the counting, and when it is told."""

import re
from argparse import Namespace
from dataclasses import replace

import pytest

from pcs_racing import InputError, load_game_config
from pcs_racing_agents.cli import estimates
from pcs_racing_agents.cli.estimates import announce, cores_of, duration_text, stage_estimates
from pcs_racing_agents.cli.main import main
from pcs_racing_agents.learning.ppo.settings import load_ppo_settings
from pcs_racing_agents.learning.responses import load_response_settings
from pcs_racing_agents.learning.robust import load_psro_settings, load_robust_settings
from pcs_racing_agents.learning.self_play import load_self_play_settings
from pcs_racing_agents.networks.settings import TrainSettings
from pcs_racing_agents.study import load_study_config
from pcs_racing_agents.synthesis.config import load_archive_config

PAPER = load_game_config("paper")


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(40, "40 s"), (60, "1 min"), (1626, "27 min"), (5399, "90 min"), (5400, "1.5 h"), (36000, "10 h")],
)
def test_durations_as_people_say_them(seconds, text):
    assert duration_text(seconds) == text


def test_work_of_less_than_a_minute_is_not_announced(capsys):
    announce(119.0, 2)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("cores", "most", "text"),
    [
        (2, False, "this takes about 3.0 h on 2 cores "),
        (1, True, "this takes at most about 6.0 h on 1 core "),
        (None, False, "this takes about 6.0 h of processor time "),
    ],
)
def test_long_work_is_announced_before_it_begins(capsys, cores, most, text):
    announce(6 * 3600.0, cores, most=most)
    assert text in capsys.readouterr().err


def test_cores_are_those_of_the_executor_and_unknown_for_a_cluster():
    assert cores_of(Namespace(scheduler=None, workers=7)) == 7
    assert cores_of(Namespace(scheduler=None, workers=None)) >= 1
    assert cores_of(Namespace(scheduler="tcp://host:8786", workers=None)) is None


def test_a_race_counts_its_seconds():
    assert estimates.racing_seconds(100, 40.0) == pytest.approx(4000 * estimates.RACING)


def test_what_races_have_in_common_counts_once():
    assert 0.0 < estimates.SHARED < 1.0
    assert estimates.shared_seconds(100, 40.0) == pytest.approx(4000 * estimates.RACING * estimates.SHARED)


def test_a_tree_counts_every_joint_history():
    segments = 1 + 16 + 256 + 4096 + 65536
    assert estimates.tree_seconds(PAPER, 4, 8, 2) == pytest.approx(16 * segments * estimates.TREE_SEGMENT)
    short = load_game_config("paper", moves=1, step_seconds=4.0)
    assert estimates.tree_seconds(short, 5, 1, 1) == pytest.approx(0.5 * 26 * estimates.TREE_SEGMENT)


def test_an_ego_tree_counts_the_histories_of_one_car():
    assert estimates.ego_seconds(PAPER, 4, 10) == pytest.approx(10 * 341 * estimates.EGO_SEGMENT)


def test_a_synthesis_counts_the_races_of_its_three_parts():
    config = load_archive_config("default")
    races = 3 * 2 * (2000 * 4 * 2 + 240 * 8 * 2) * 16.0 + 3 * 2 * 80 * 12 * 3 * 40.0
    assert estimates.synthesis_seconds(config) == pytest.approx(races * estimates.RACING)


@pytest.mark.parametrize(("name", "rate"), [("duel-paper", "DUEL_MOVE"), ("drive", "DRIVE_STEP")])
def test_ppo_counts_the_steps_of_all_seeds(name, rate):
    settings = load_ppo_settings(name, steps=1000, seeds=(0, 1, 2))
    assert estimates.ppo_seconds(settings) == pytest.approx(3000 * getattr(estimates, rate))


def test_a_network_counts_the_rows_of_all_epochs():
    assert estimates.training_seconds(TrainSettings(epochs=10, rows_per_epoch=500)) == pytest.approx(
        5000 * estimates.ROW
    )


def test_an_answer_counts_branches_to_the_end_of_the_game_and_its_networks():
    settings = load_response_settings("response", starts=512, rounds=2, members=4, epochs=60)
    rows = [min(512 * 9 * fits, 50_000) for fits in range(1, 9)]
    networks = (2 * sum(rows) + 2 * rows[-1]) * 60 * estimates.ROW
    racing = 512 * 2 * 9 * 8.0 * sum((k + 1) + 4 * (4 - k) for k in range(4))
    assert estimates.response_seconds(settings, PAPER, 4, 9) == pytest.approx(racing * estimates.RACING + networks)


def test_robust_answers_count_their_responses_and_self_play_its_iterations():
    robust = load_robust_settings("default")
    each = estimates.response_seconds(robust.response(0), PAPER, 4, 2)
    assert estimates.robust_seconds(robust, PAPER, 4, 2) == pytest.approx((1 + 2 * robust.rounds) * each)
    assert estimates.robust_seconds(replace(robust, pool_share=1.0), PAPER, 4, 2) == pytest.approx(each)
    psro = load_psro_settings("default", rounds=3, races=10)
    races = estimates.racing_seconds(3 * 10 * 2, 40.0)
    assert estimates.psro_seconds(psro, PAPER, 4, 2) == pytest.approx(3 * each + races)
    play = load_self_play_settings("default", iterations=2)
    one = estimates.self_play_seconds(replace(play, iterations=1), PAPER, 4, 2)
    assert estimates.self_play_seconds(play, PAPER, 4, 2) == pytest.approx(2 * one)


def test_a_study_is_estimated_stage_by_stage():
    paper = load_study_config("paper", robust="default", psro="default", self_play="default", replies=("response",))
    stages = stage_estimates(paper)
    assert all(seconds > 0.0 for seconds in stages.values())
    twice = stage_estimates(
        replace(paper, replies=("response", "never-switch"), sampled_cfr="default", targets=("nash",))
    )
    assert twice["best-replies"] == 2 * stages["best-replies"]
    assert twice["self-play"] == 2 * stages["self-play"]
    doubled = stage_estimates(replace(paper, lines=2 * paper.lines, further_lines=2))
    assert doubled["races"] == 2 * stages["races"]
    bare = stage_estimates(load_study_config("contest-table"))
    assert bare["trees"] == bare["networks"] == bare["ppo"] == 0.0


COMMANDS = {
    "tree --pairs 64": "pcs_racing_agents.cli.tree.build_trees",
    "synthesize": "pcs_racing_agents.cli.synthesize.make_archive",
    "ppo --config duel-paper": "pcs_racing_agents.learning.ppo.train.train_ppo",
    "study paper": "pcs_racing_agents.study.run_study",
    "tournament --agents never-switch random-moves random-policy lane-switcher --track Tarnfjord Pipkin --races 2000": (
        "pcs_racing_agents.tournament.play_plan"
    ),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_long_command_says_how_long_it_takes_before_it_begins(command, capsys, monkeypatch, tmp_path):
    captured = []

    def begin(*_arguments, **_options):
        captured.append(capsys.readouterr().err)
        raise InputError("begun")

    monkeypatch.setattr(COMMANDS[command], begin)
    assert main([*command.split(), "--workers", "1", "--out", str(tmp_path / "out")]) == 2
    assert re.match(r"pcs-racing: this takes (at most )?about [\d.]+ (min|h) on 1 core ", captured[0])
