"""Archives of front policies and of strong policies far apart, as resumable runs."""

import csv
import shutil
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from long_jobs import SETTINGS, files
from refusal import refused

from pcs_racing import load_archive
from pcs_racing.game.moves import duplicate_share, no_op_share
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.registry import parse_policy
from pcs_racing.testing import check_archive
from pcs_racing_agents.base.executors import make_executor
from pcs_racing_agents.policies.archive_report import front_picture, hypervolume_error
from pcs_racing_agents.policies.archive_run import ArchiveRun, stage_scenarios, synthesize
from pcs_racing_agents.policies.config import ArchiveConfig, load_archive_config
from pcs_racing_agents.policies.evaluate import Evaluation, race_policies, summarise
from pcs_racing_agents.policies.pareto import Scale, front_layers, hypervolume, non_dominated

pytest.importorskip("cma")
pytest.importorskip("moocore")

TINY = ArchiveConfig(
    name="tiny",
    tracks=("Pipkin", "Tarnfjord"),
    duration=4.0,
    final_duration=8.0,
    segment_seconds=2.0,
    generations=3,
    population=6,
    initial_sample=12,
    opponents=2,
    starts=1,
    crash_limit=0.4,
    candidates=16,
    choice_opponents=2,
    choice_starts=1,
    final_opponents=3,
    final_starts=1,
    min_policies=2,
    seed=6,
)


def with_(**changes) -> ArchiveConfig:
    return load_archive_config(TINY, **changes)


SPREAD = ArchiveConfig(
    name="spread",
    preset="contest",
    tracks=("Pipkin",),
    rivals=("lane-switcher", "gap-follower"),
    champions=1,
    champion_generations=2,
    margin=0.5,
    duration=4.0,
    final_duration=4.0,
    segment_seconds=2.0,
    characteristics=("speed", "smoothness"),
    generations=1,
    population=4,
    initial_sample=8,
    opponents=0,
    starts=1,
    crash_limit=1.0,
    selection="spread",
    candidates=8,
    choice_opponents=0,
    choice_starts=1,
    final_opponents=0,
    final_starts=2,
    min_policies=3,
    max_policies=4,
    seed=5,
)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """An archive, its folder, and the progress of its run."""
    folder, progress = tmp_path_factory.mktemp("archive") / "made", []
    return synthesize(TINY, folder, callback=progress.append), folder, progress


@pytest.fixture(scope="module")
def spread(tmp_path_factory):
    """An archive of policies far apart, its folder, and the progress of its run."""
    folder, progress = tmp_path_factory.mktemp("archive") / "spread", []
    return synthesize(SPREAD, folder, callback=progress.append), folder, progress


def stated(facts: dict) -> dict:
    """Return facts with the digits of a manifest."""
    return {
        key: value if isinstance(value, str) else float(f"{value:.6g}")
        for key, value in facts.items()
    }


def test_an_archive_is_made_and_can_be_loaded_and_raced(made):
    archive, folder, _ = made
    names = {"archive.npz", "manifest.yaml", "hypervolume.csv", "front.png"}
    found = {file.name for file in folder.iterdir() if file.is_file()}
    assert found in (names, names - {"front.png"})  # without matplotlib
    loaded = load_archive(folder)
    check_archive(loaded)
    np.testing.assert_array_equal(loaded.coordinates, archive.coordinates)
    assert loaded.settings == archive.settings
    assert len(loaded) == archive.settings["policies"] >= 2
    assert (np.diff(loaded.coordinates[:, 0]) >= 0.0).all()
    assert len(loaded.explored.parameters) == TINY.evaluations == 12 + 3 * 6
    assert loaded.explored.own_crash is not None
    assert (loaded.own_crash <= TINY.crash_limit).all()
    assert loaded.preset == "paper"


def test_the_manifest_states_settings_versions_and_what_each_stage_left_out(made):
    archive, settings = made[0], made[0].settings
    explored = archive.explored
    allowed = explored.own_crash <= TINY.search_crash_limit
    sample = explored.coordinates[:12]  # its range is the unit
    points = Scale.of(sample)(explored.coordinates)
    facts = {
        "tracks": "Pipkin, Tarnfjord",
        "seed": 6,
        "characteristics": "aggressiveness, restraint",
        "fixed": "",
        "min_coordinates": "none",
        "cma_version": version("cma"),
        "moocore_version": version("moocore"),
        "numba_version": version("numba"),
        "numpy_version": np.__version__,
        "package_version": version("pcs-racing"),
        "search_over_crash_limit": np.sum(~allowed),
        "search_hypervolume": hypervolume(points[allowed]),
        "search_hypervolume_without_crash_limit": hypervolume(points),
    }
    assert {key: settings[key] for key in facts} == stated(facts)
    assert not {*settings} & {"margin"}
    assert "Tarnfjord " in settings["track_hashes"]
    reasons = ("choice_outside_limits", "choice_beaten", "choice_too_near_another")
    reasons += ("measurement_outside_limits", "measurement_beaten")
    assert settings["choice_candidates"] - sum(settings[why] for why in reasons) == len(archive)


def test_progress_and_the_curve_follow_the_search(made):
    """The initial sample and three generations; the finished share counts by the races."""
    archive, folder, progress = made
    explored, ends = archive.explored, [12, 18, 24, 30]
    search = [step for step in progress if step.stage == "search"]
    assert [(n.generation, n.generations, n.evaluations) for n in search] == [
        (k, 3, end) for k, end in enumerate(ends)
    ]
    crashes = [part.mean() for part in np.split(explored.own_crash, ends[:-1])]
    assert [n.own_crash for n in search] == pytest.approx(crashes)
    sample = explored.coordinates[:12]
    first = sample[explored.own_crash[:12] <= TINY.search_crash_limit]
    volume = hypervolume(Scale.of(sample)(first))
    assert search[0][4:6] == (pytest.approx(volume), non_dominated(first).sum())
    volumes = [n.hypervolume for n in progress]
    assert volumes == sorted(volumes)  # the same races for all: the front only grows
    # 2 tracks, both sides, opponents, start lines and seconds.
    work = np.array([30 * 4 * 2 * 1 * 4.0, 16 * 4 * 2 * 1 * 4.0, 80 * 4 * 3 * 1 * 8.0])
    assert list(TINY.work.values()) == work.tolist()
    assert [n.done for n in search] == pytest.approx(np.array(ends) / 30 * work[0] / work.sum())
    done = {n.stage: n.done for n in progress}
    assert done == pytest.approx(dict(zip(done, np.cumsum(work) / work.sum(), strict=True)))
    assert (list(done), progress[-1].front) == (["search", "choice", "measurement"], len(archive))
    rows = list(csv.reader((folder / "hypervolume.csv").read_text().splitlines()))
    assert rows[0] == ["generation", "evaluations", "hypervolume", "front", "own_crash"]
    assert [[float(cell) for cell in row] for row in rows[1:]] == [
        pytest.approx([*n[1:2], *n[3:7]], abs=1e-4) for n in search
    ]


def test_the_coordinates_come_from_races_of_their_own(made):
    """Measured here once more, from the configuration alone."""
    archive = made[0]
    search, choice, final = stage_scenarios(TINY)
    assert final.config.duration == 8.0
    for earlier in (search, choice):
        assert not np.isin(final.seed, earlier.seed).any()
        assert not (final.opponents[:, None] == earlier.opponents[None]).all(axis=-1).any()
    raced = race_policies((final, archive.parameters))
    found = summarise(raced)
    np.testing.assert_array_equal(found.coordinates, archive.coordinates)
    np.testing.assert_array_equal(found.spread, archive.spread)
    np.testing.assert_array_equal(found.own_crash, archive.own_crash)
    scale = Scale.of(archive.explored.coordinates[:12])
    facts = {
        "policies_not_beaten": np.sum(front_layers(found.coordinates) == 0),
        "hypervolume": hypervolume(scale(found.coordinates)),
        "hypervolume_error": hypervolume_error(raced, scale),
        "own_crash_mean": found.own_crash.mean(),
        "own_crash_max": found.own_crash.max(),
        "win_share": (raced["winner"] == 0).mean(),
        "no_op_share": no_op_share(archive),
        "duplicate_share": duplicate_share(archive),
        "correlation_aggressiveness_restraint": np.corrcoef(found.coordinates.T)[0, 1],
    }
    for axis, low, high in zip(TINY.axes, scale.nadir, scale.ideal, strict=True):
        unit = f"0 at {low:.4f}, 1 at {high:.4f} (range of the initial sample)"
        facts[f"hypervolume_unit_{axis}"] = unit
    assert {key: archive.settings[key] for key in facts} == stated(facts)


def test_policies_far_apart_lie_around_the_champion(spread):
    archive, folder, progress = spread
    check_archive(load_archive(folder))
    assert 3 <= len(archive) <= 4
    settings, explored = archive.settings, archive.explored.parameters
    assert len(explored) == SPREAD.evaluations == 8 + 4 * 4  # both axes up and down
    champion = parse_policy(settings["champion_1"]).parameters
    np.testing.assert_array_equal(explored[0], champion)
    assert any((theta == champion).all() for theta in archive.parameters)
    assert (settings["selection"], settings["margin"]) == ("spread", 0.5)
    assert [*dict.fromkeys(step.stage for step in progress)] == [*SPREAD.work]
    met = 2 * 3  # both sides, two rivals and a champion
    work = (2 * 16 * 2 * 2.5 * 2 * 4.0, 24 * met * 4.0, 8 * met * 4.0, 4 * 2 * met * 4.0)
    assert tuple(SPREAD.work.values()) == work


def test_a_champion_is_the_result_of_a_tuning_and_meets_the_champions_before_it(spread, tmp_path):
    config = SPREAD.tuning(("lattice:pace=1",), 3)
    assert config.against == ("lane-switcher", "gap-follower", "lattice:pace=1")
    assert (config.start, config.generations, config.duration) == ("lattice:pace=1", 2, 4.0)
    assert SPREAD.tuning(("lattice", "lattice"), 3).against == (*SPREAD.rivals, "lattice")
    names = {file.name.rpartition("-")[0] for file in (spread[1] / "job" / "chunks").iterdir()}
    assert {"champion-1-00001", "champion-1-00002", "champion-1-choice"} <= names


def test_the_error_of_a_hypervolume_is_its_spread_over_draws_of_the_races():
    """Two policies in 30 pairs of races, which have their luck in common."""
    rng = np.random.default_rng(0)
    volumes, errors = [], []
    for _ in range(60):
        luck = np.repeat(rng.normal(0.0, 0.4, (1, 30, 1)), 2, axis=1)
        segments = rng.integers(1, 3, (2, 60))
        totals = (np.array([[[0.4, 0.8]], [[0.8, 0.4]]]) + luck) * segments[..., None]
        points = totals.sum(axis=1) / segments.sum(axis=1)[:, None]
        volumes.append(hypervolume(points))
        raced = {"totals": totals, "segments": segments}
        errors.append(hypervolume_error(raced, Scale(np.ones(2), np.zeros(2))))
    assert np.mean(errors) == pytest.approx(np.std(volumes), rel=0.2)


def test_limits_are_violated_by_the_largest_shortfall():
    """Crashes, the score against rivals, and coordinates in units of the initial sample."""
    config = with_(crash_limit=0.19, rivals=("lane-switcher",), min_coordinates=(1.0, 2.0))
    assert config.search_crash_limit == pytest.approx(0.1)
    assert config.work["search"] == 30 * 2 * (2 + 1) * 2 * 4.0
    assert (config.work["choice"], config.work["measurement"]) == (
        16 * 4 * 3 * 4.0,
        80 * 4 * 4 * 8.0,
    )
    run = ArchiveRun(config, None, None, None, min_score=0.5)
    corners = np.array([[10.0, 0.0], [0.0, 4.0]])
    run.searched.append((corners, Evaluation(corners, *[corners[:, 0]] * 4)))
    coordinates = np.array([[2.0, 3.0], [2.0, 3.0], [2.0, 3.0], [0.0, 3.0], [2.0, 1.0]])
    crashes, score = np.array([0.05, 0.3, 0.1, 0.1, 0.1]), np.array([0.6, 0.6, 0.2, 0.5, 0.5])
    evaluation = Evaluation(coordinates, crashes, coordinates, crashes, score)
    assert run.violation(evaluation) == pytest.approx([-0.05, 0.2, 0.3, 0.1, 0.25])
    run.config, run.min_score = with_(crash_limit=0.19), 0.0
    assert run.violation(evaluation) == pytest.approx([-0.05, 0.2, 0.0, 0.0, 0.0])


def test_the_picture_of_an_archive_shows_the_front_with_its_errors(made):
    pytest.importorskip("matplotlib")
    archive = replace(made[0], own_crash=np.linspace(0.0, 0.3, len(made[0])))
    plot, bar = front_picture(archive).axes
    points, spread = archive.coordinates[:, ::-1], archive.spread[:, ::-1]
    assert plot.get_title("left").startswith("archive tiny, preset paper; bars: one standard error")
    assert (plot.get_xlabel(), plot.get_ylabel()) == ("restraint (s)", "aggressiveness (m)")
    assert bar.get_ylabel() == "own crashes in % of the measuring races"
    labels = [text.get_text() for text in plot.get_legend().get_texts()]
    assert labels == ["30 explored", f"{len(archive)} policies"]
    explored, dots = plot.lines[0].get_xydata(), plot.collections[-1]
    np.testing.assert_array_equal(explored, archive.explored.coordinates[:, ::-1])
    np.testing.assert_array_equal(dots.get_offsets(), points)
    np.testing.assert_array_equal(dots.get_array(), 100.0 * archive.own_crash)
    bars = [part for part in plot.collections if hasattr(part, "get_segments")]
    for k, lines in enumerate(bars):
        ends = np.array(lines.get_segments())[:, :, k].T
        np.testing.assert_allclose(ends, [points[:, k] - spread[:, k], points[:, k] + spread[:, k]])


def test_fixed_parameters_keep_their_values_of_the_start(tmp_path):
    """The search has a dimension less for each; its opponents do not vary them either."""
    start = "lattice:early,blocking=0.25"
    config = with_(generations=1, start=start, fixed=("pace_behind", "blocking"))
    assert set(LATTICE.parameter_names) - set(config.varied) == {"pace_behind", "blocking"}
    archive = synthesize(config, tmp_path / "made")
    assert archive.parameter_names == LATTICE.parameter_names
    rows, final = LATTICE.indices(config.fixed), stage_scenarios(config)[2]
    for theta in (archive.parameters, archive.explored_parameters, final.opponents):
        np.testing.assert_array_equal(theta[:, rows] - [0.15, 0.25], 0.0)
    found = summarise(race_policies((final, archive.parameters)))
    np.testing.assert_array_equal(found.coordinates, archive.coordinates)


def test_the_executor_has_no_influence(made, spread, tmp_path):
    with make_executor("threads", 2) as executor:
        for config, folder in ((TINY, made[1]), (SPREAD, spread[1])):
            synthesize(config, tmp_path / config.name, executor=executor)
            assert files(tmp_path / config.name) == files(folder)


def test_a_finished_run_races_nothing_again(made, spread, monkeypatch, tmp_path):
    folder = Path(shutil.copytree(made[1], tmp_path / "copy"))
    monkeypatch.setattr("pcs_racing_agents.policies.evaluate.advance", None)
    np.testing.assert_array_equal(synthesize(SPREAD, spread[1]).parameters, spread[0].parameters)
    # of a run that was killed while it wrote
    (folder / ".archive.npz.0123abcd").write_bytes(b"half")
    synthesize(TINY, folder)
    assert files(folder) == files(made[1])


def test_other_folders_and_runs_are_left_alone(made, tmp_path):
    shipped = tmp_path / "shipped"
    shutil.copytree(made[1], shipped, ignore=shutil.ignore_patterns("job"))
    for folder, config, words in (
        (shipped, TINY, r"archive\.npz but no run"),
        (made[1], with_(generations=4), "generations is 3, not 4"),
    ):
        before = files(folder)
        refused(words, synthesize, config, folder)
        assert files(folder) == before


def test_a_crash_limit_leaves_out_policies_that_crash(tmp_path):
    """Rules under which many crash; the limit is lower in the shorter races of the search."""
    wild = tmp_path / "wild.yaml"
    wild.write_text("preset: contest\nname: wild\nspeed_range: [1.2, 1.7]\n")
    config = with_(preset=str(wild), crash_limit=0.3, seed=12)
    assert config.search_crash_limit == pytest.approx(1.0 - 0.7**0.5)
    archive = synthesize(config, tmp_path / "archive")
    assert (archive.preset, archive.characteristics) == ("wild", ("speed", "reaction"))
    assert (archive.own_crash <= 0.3).all()
    facts, over = archive.settings, archive.explored.own_crash > config.search_crash_limit
    assert facts["search_over_crash_limit"] == over.sum() > 0
    assert facts["search_hypervolume"] < facts["search_hypervolume_without_crash_limit"]
    wild.write_text("preset: contest\nname: wild\nspeed_range: [2.0, 3.0]\n")
    hopeless = with_(preset=str(wild), crash_limit=0.0, tracks=("Tarnfjord",))
    refused(r"all 30 policies|crash limit of 0%", synthesize, hopeless, tmp_path / "none")


def test_a_measurement_leaves_out_policies_that_score_too_little(monkeypatch, tmp_path):
    real, measured = ArchiveRun._race, []

    def race(run, stage, name, scenarios, parameters):
        raced = real(run, stage, name, scenarios, parameters)
        if stage == "measurement":
            raced["winner"][1:], raced["crashed"][1:] = 0, False  # every race won
            raced["winner"][0], raced["crashed"][0] = 1, False  # every race lost
            measured.append(len(parameters))
        return raced

    monkeypatch.setattr(ArchiveRun, "_race", race)
    archive = synthesize(replace(SPREAD, margin=0.2, min_policies=1), tmp_path / "made")
    assert archive.settings["measurement_outside_limits"] == 1
    assert len(archive) == measured[0] - 1


def test_policies_below_the_least_coordinates_stay_out_and_too_few_are_told(tmp_path, made, caplog):
    archive = synthesize(with_(min_coordinates=(0.0, 0.0), seed=7), tmp_path / "least")
    assert archive.coordinates[:, 0].min() > made[0].coordinates[:, 0].min() + 0.2
    assert (archive.explored.coordinates[:, 0] < 0.0).any()
    archive = synthesize(with_(min_policies=60, crash_limit=0.0), tmp_path / "few")
    assert not archive.own_crash.any()
    assert f"the archive holds {len(archive)} policies; 60 were wanted" in caplog.text


def test_impossible_settings_are_refused():
    for changes, message in [
        ({"generations": -1}, "generations is -1"),
        ({"duration": 5.0}, "duration is 5 s"),
        ({"min_coordinates": (1.0,)}, "min_coordinates is"),
        ({"min_coordinates": (1.0, "x")}, "min_coordinates is"),
        ({"min_policies": 81}, "min_policies is 81, above max_policies, 80"),
        ({"champions": 1}, "champions is 1, but there are no rivals"),
        ({"opponents": 0}, "there are no rivals, and a stage has no opponents"),
        ({"start": "spliner"}, "start is 'spliner'; it must be a policy of planner 'lattice'"),
        ({"duration": 0.9}, r"duration is 0\.9 s"),
        ({"final_duration": 8.001}, r"final_duration is 8\.001 s"),
        ({"fixed": ("speed",)}, "has no parameter 'speed'"),
        ({"fixed": LATTICE.parameter_names[1:]}, "fixed leaves 1 parameters"),
        ({"characteristics": ("speed",)}, "the search needs at least 2"),
        ({"characteristics": ("charm",)}, "characteristic 'charm' is unknown"),
        ({"preset": "nothing"}, "race settings 'nothing' are unknown"),
        ({"speed": 3}, "unknown archive setting 'speed'"),
        ({"rivals": ("nobody",)}, "planner 'nobody' is unknown"),
    ]:
        refused(message, with_, **changes)
    for changes, message in [
        ({"rivals": (), "champions": 0, "opponents": 1}, "selection is 'spread', but"),
        ({"max_policies": 2, "min_policies": 2}, "max_policies is 2; policies far apart"),
        ({"selection": "luck"}, "luck"),
    ]:
        refused(message, load_archive_config, SPREAD, **changes)


def test_the_command(tmp_path, run, told):
    given = ["--config", SETTINGS / "synthesis.yaml", "--track", "Pipkin", "--generations", 0]
    arguments = ["synthesize", *given, "--population", 4, "--out", tmp_path / "a"]
    code, out, err = run(*arguments, "--name", "small", "--executor", "threads")
    assert code == 0
    assert "<PolicyArchive 'small'" in out
    assert f"archive: {tmp_path / 'a'}" in out
    assert "100/100 % of the races" in err
    code, _, err = run(*arguments, "--name", "other")
    assert code == 2
    assert "its name is 'small', not 'other'" in err
    unknown = told("synthesize", "--config", "nothing", "--out", tmp_path / "b")
    assert "archive settings 'nothing' are unknown; use contest, default or the path" in unknown
    assert not (tmp_path / "b").exists()
