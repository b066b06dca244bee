"""The races behind learned characteristics, an archive on other axes, and the commands."""

from dataclasses import replace

import numpy as np
import pytest
from zoo_games import toy_archive

from pcs_racing import InputError, get_planner, load_archive, load_race_config, make_game, parse_policy, save_archive
from pcs_racing_agents.base.jobs import open_job
from pcs_racing_agents.policies.policy_pool import PolicyPool
from studies.__main__ import main
from studies.axes.apply import ApplySettings, apply_characteristics
from studies.axes.behaviour import measure_behaviour, measure_payoffs
from studies.axes.learn import LearnSettings, learn_characteristics
from studies.axes.learned import LearnedAxis, LearnedCharacteristics, LearnedInput, load_learned, save_learned
from studies.axes.pools import draw_pool

CONFIG = load_race_config("contest", duration=4.0)
TRACKS = ("Tarnfjord", "Pipkin")
POLICIES = tuple(parse_policy(f"lattice:pace={pace}") for pace in (0.1, 0.4, 0.7, 1.0))
TOY = LearnedCharacteristics(
    "raced",
    (LearnedInput("cornering", 3.0, 1.0),),
    (LearnedAxis("raced_calm", "less of it", 0.0, (("cornering", -1.0),)),),
)
FEW = ApplySettings(opponents=2, starts=1, explored_opponents=1)


pytestmark = pytest.mark.usefixtures("own_registry")


def test_every_piece_of_every_race_is_measured():
    seen = measure_behaviour(POLICIES[:2], POLICIES[2:], TRACKS, CONFIG, ["speed"], starts=2, segment_seconds=1.0)
    assert seen.shape == (2, 2, 2 * 2 * 2 * 4, 1)  # circuits, policies, opponents x starts x sides x segments
    means = np.nanmean(seen[..., 0], axis=2)
    assert (means[:, 1] > means[:, 0]).all()


def test_payoffs_against_a_pool_are_races_won():
    won = measure_payoffs(POLICIES[:2], POLICIES[2:], TRACKS, CONFIG, starts=1)
    assert won.shape == (2, 2, 2)
    assert set(np.unique(won)) <= {-0.5, -0.25, 0.0, 0.25, 0.5}
    assert won.mean() < 0.0  # the opponents are faster


def test_drawn_pools_go_from_slow_to_fast_and_repeat():
    first, again = (draw_pool(get_planner("lattice"), TRACKS[:1], CONFIG, 3, seed=4, segment_seconds=2.0) for _ in "ab")
    seen = measure_behaviour(first, POLICIES[:1], TRACKS[:1], CONFIG, ["speed"], segment_seconds=2.0)
    speeds = np.nanmean(seen[0, :, :, 0], axis=1)
    assert speeds[0] < speeds[2]
    assert [policy.parameters.tolist() for policy in first] == [policy.parameters.tolist() for policy in again]


def test_workers_and_resumed_jobs_learn_the_same(processes, tmp_path, monkeypatch):
    pool = PolicyPool(POLICIES, TRACKS[:1], CONFIG, races=8, folds=4)
    settings = LearnSettings(inputs=("speed",), opponents=4, starts=2, segment_seconds=1.0, folds=2)
    with open_job(tmp_path, "characteristics", {}) as job:
        expected = learn_characteristics(pool, settings, job=job).characteristics
    assert learn_characteristics(pool, settings, executor=processes).characteristics == expected
    monkeypatch.setattr("pcs_racing_agents.policies.evaluate.advance", None)  # nothing is raced again
    monkeypatch.setattr("pcs_racing_agents.policies.policy_pool.advance", None)
    with open_job(tmp_path, "characteristics", {}) as job:
        assert learn_characteristics(pool, settings, job=job).characteristics == expected


def test_an_archive_on_learned_axes_keeps_its_policies_and_makes_games(processes):
    archive = toy_archive(4)
    axes, rules = ["raced_calm", "speed"], replace(CONFIG, duration=8.0)
    made = apply_characteristics(archive, TOY, TRACKS[:1], rules, axes=axes, settings=FEW)
    np.testing.assert_array_equal(made.parameters, archive.parameters)
    np.testing.assert_array_equal(made.explored_parameters, archive.explored_parameters)
    assert made.characteristics == ("raced_calm", "speed")
    assert made.explored_coordinates.shape == (30, 2)
    assert (np.diff(made.coordinates[:, 1]) > 0.0).all()  # from slow to fast
    # Other processes learn of the axes from their tasks.
    again = apply_characteristics(archive, TOY, TRACKS[:1], rules, axes=axes, settings=FEW, executor=processes)
    assert again.content_hash == made.content_hash
    game = make_game(TRACKS[0], made, CONFIG, moves=1, step_seconds=2.0)
    state = game.step(game.reset(games=2), [[0, 3], [1, 2]])
    assert np.isfinite(game.observation(state)).all()


def test_axes_are_needed():
    with pytest.raises(InputError, match="axes"):
        apply_characteristics(toy_archive(4), None, TRACKS, CONFIG)


# Commands


def test_learn_show_and_apply(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    out, rules = tmp_path / "learned", ["--track", "Tarnfjord", "--race", "contest", "--duration", "8"]
    pool = ["--policies", *(f"lattice:pace={pace}" for pace in (0.1, 0.4, 0.7, 1.0)), "--races", "32"]
    few = ["--inputs", "speed", "restraint", "--opponents", "4", "--starts", "2", "--folds", "2", "--name", "mine"]
    assert main(["axes", "learn", *pool, *rules, *few, "--out", str(out)]) == 0
    assert "mine_cycle_1" in capsys.readouterr().out
    assert (out / "characteristics.png").stat().st_size > 10_000
    file = out / "characteristics.yaml"
    assert load_learned(file).names == ("mine_rating", "mine_cycle_1", "mine_cycle_2")
    assert len((out / "weights.csv").read_text().splitlines()) == 1 + 3 * (1 + 5)
    assert main(["axes", "show", str(file)]) == 0
    assert "mine_rating" in capsys.readouterr().out
    archive = save_archive(toy_archive(4), tmp_path / "toy")
    applied = ["axes", "apply", "--archive", str(archive), "--learned", str(file), "--track", "Tarnfjord"]
    few = ["--axes", "speed", "mine_rating", "--opponents", "1", "--starts", "1", "--explored-opponents", "1"]
    assert main([*applied, *few, "--out", str(tmp_path / "mine")]) == 0
    made = load_archive(tmp_path / "mine")
    assert made.characteristics == ("speed", "mine_rating")
    assert load_learned(tmp_path / "mine" / "characteristics.yaml") == load_learned(file)


@pytest.mark.parametrize(
    ("wrong", "value"),
    [
        (["learn", "--size", "2"], "2"),
        (["learn", "--size", "4"], "folds"),
        (["learn", "--races", "33"], "33"),
        (["learn", "--inputs", "charm"], "charm"),
        (["learn", "--opponents", "1"], "1 opponents"),
        (["apply"], "--learned"),
        (["apply", "--learned", "nowhere.yaml"], "nowhere.yaml"),
        (["apply", "--archive", "nobody's", "--axes", "speed"], "nobody's"),
        (["apply", "--axes", "charm"], "charm"),
    ],
)
def test_what_cannot_be_is_refused_before_any_race(tmp_path, capsys, wrong, value):
    assert main(["axes", *wrong, "--out", str(tmp_path / "out")]) == 2
    assert value in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_set_is_shown_from_its_file(tmp_path, capsys):
    assert main(["axes", "show", str(save_learned(TOY, tmp_path / "toy.yaml"))]) == 0
    assert "raced_calm (less of it): +0.00 -1.00 cornering" in capsys.readouterr().out
