"""Archives of front policies and of strong policies far apart, as resumable runs."""

import csv
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from long_jobs import SETTINGS, files
from refusal import refused

from pcs_racing import load_archive
from pcs_racing.envs import RandomCircuits, random_circuit
from pcs_racing.game.moves import duplicate_share, no_op_share
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.planners.registry import parse_policy
from pcs_racing.testing import check_archive
from pcs_racing_agents.policies.archive_report import stated_settings
from pcs_racing_agents.policies.archive_run import SpreadRun, stage_scenarios, synthesize
from pcs_racing_agents.policies.config import FrontConfig, SpreadConfig, load_archive_config
from pcs_racing_agents.policies.evaluate import circuit, race_policies, summarise
from pcs_racing_agents.policies.pareto import Scale, front_layers, hypervolume, non_dominated

pytest.importorskip("cma")
pytest.importorskip("moocore")

TINY = FrontConfig(
    name="tiny",
    tracks=("Pipkin", "Tarnfjord"),
    duration=4.0,
    final_duration=8.0,
    segment_seconds=2.0,
    generations=3,
    population=6,
    initial_sample=12,
    opponents=1,
    starts=1,
    crash_limit=0.4,
    candidates=16,
    generated=1,
    choice_tracks=("Brackwater",),
    final_starts=1,
    seed=6,
)
SPREAD = SpreadConfig(
    name="spread",
    rules="contest",
    tracks=("Pipkin",),
    rivals=("lane-switcher", "gap-follower"),
    champion_generations=2,
    margin=0.5,
    duration=4.0,
    final_duration=4.0,
    segment_seconds=2.0,
    characteristics=("speed", "smoothness"),
    generations=1,
    population=4,
    initial_sample=8,
    starts=1,
    crash_limit=1.0,
    candidates=8,
    final_starts=2,
    max_policies=4,
    seed=5,
)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """An archive, its folder, and the calls of the callback."""
    folder, calls = tmp_path_factory.mktemp("archive") / "made", []
    return synthesize(TINY, folder, callback=lambda *call: calls.append(call)), folder, calls


@pytest.fixture(scope="module")
def spread(tmp_path_factory):
    """An archive of policies far apart, its folder, and the calls of the callback."""
    folder, calls = tmp_path_factory.mktemp("archive") / "spread", []
    return synthesize(SPREAD, folder, callback=lambda *call: calls.append(call)), folder, calls


def stated(facts: dict) -> dict:
    """Return facts with the digits of a manifest."""
    return {
        key: value if isinstance(value, str) else float(f"{value:.6g}")
        for key, value in facts.items()
    }


def test_an_archive_is_made_and_can_be_loaded_and_raced(made):
    archive, folder, _ = made
    names = {"archive.npz", "manifest.yaml", "hypervolume.csv", "front.png", "job.yaml"}
    found = {file.name for file in folder.iterdir() if file.is_file()}
    assert found in (names, names - {"front.png"})  # without matplotlib
    loaded = load_archive(folder)
    check_archive(loaded)
    np.testing.assert_array_equal(loaded.coordinates, archive.coordinates)
    assert loaded.settings == archive.settings
    assert len(loaded) == archive.settings["policies"] >= 2
    assert (np.diff(loaded.coordinates[:, 0]) >= 0.0).all()
    assert len(loaded.explored_parameters) == TINY.evaluations == 12 + 3 * 6
    assert (loaded.own_crash <= TINY.crash_limit).all()
    assert loaded.rules == "paper"


def test_the_manifest_states_settings_and_what_each_stage_left_out(made):
    archive, settings = made[0], made[0].settings
    explored = archive.explored_coordinates
    allowed = archive.explored_own_crash <= TINY.search_crash_limit
    points = Scale.of(explored[:12])(explored)
    facts = {
        "tracks": "Pipkin, Tarnfjord",
        "seed": 6,
        "characteristics": "aggressiveness, restraint",
        "fixed": "",
        "min_coordinates": "none",
        "numpy_version": np.__version__,
        "search_over_crash_limit": np.sum(~allowed),
        "search_hypervolume": hypervolume(points[allowed]),
        "search_hypervolume_without_crash_limit": hypervolume(points),
    }
    assert {key: settings[key] for key in facts} == stated(facts)
    raced = [one.split()[0] for one in settings["track_hashes"].split(", ")]
    assert raced == ["Pipkin", "Tarnfjord", "generated-0", "Brackwater"]
    reasons = ("choice_outside_limits", "choice_beaten", "choice_too_near_another")
    reasons += ("measurement_outside_limits", "measurement_beaten")
    assert settings["choice_candidates"] - sum(settings[why] for why in reasons) == len(archive)


def test_progress_and_the_curve_follow_the_search(made):
    archive, folder, calls = made
    own_crash, ends = archive.explored_own_crash, [12, 18, 24, 30]
    search = [call for call in calls if call[0] == "search"]
    assert [call[1:3] for call in search] == [(end, 30) for end in ends]
    crashes = [part.mean() for part in np.split(own_crash, ends[:-1])]
    course = [state for _, _, _, state in search]
    assert [state.own_crash for state in course] == pytest.approx(crashes)
    sample = archive.explored_coordinates[:12]
    first = sample[own_crash[:12] <= TINY.search_crash_limit]
    volume = hypervolume(Scale.of(sample)(first))
    assert course[0][:4] == (0, 12, pytest.approx(volume), non_dominated(first).sum())
    volumes = [state.hypervolume for state in course]
    assert volumes == sorted(volumes)  # the same races for all: the front only grows
    assert list(dict.fromkeys(call[0] for call in calls)) == ["search", "choice", "measurement"]
    rows = list(csv.reader((folder / "hypervolume.csv").read_text().splitlines()))
    assert rows[0] == ["generation", "evaluations", "hypervolume", "front", "own_crash"]
    assert [[float(cell) for cell in row] for row in rows[1:]] == [
        pytest.approx([*state], abs=1e-4) for state in course
    ]


def test_the_coordinates_come_from_races_of_their_own(made):
    """Measured here once more, from the configuration alone."""
    archive = made[0]
    search, choice, final = stage_scenarios(TINY)
    assert [len(stage.opponents) for stage in (search, choice, final)] == [1, 2, 3]
    assert final.config.duration == 8.0
    for earlier in (search, choice):
        assert not np.isin(final.seed, earlier.seed).any()
        assert not (final.opponents[:, None] == earlier.opponents[None]).all(axis=-1).any()
    raced = race_policies((final, archive.parameters))
    found = summarise(raced)
    np.testing.assert_array_equal(found.coordinates, archive.coordinates)
    np.testing.assert_array_equal(found.spread, archive.spread)
    np.testing.assert_array_equal(found.own_crash, archive.own_crash)
    scale = Scale.of(archive.explored_coordinates[:12])
    facts = {
        "policies_not_beaten": np.sum(front_layers(found.coordinates) == 0),
        "hypervolume": hypervolume(scale(found.coordinates)),
        "own_crash_max": found.own_crash.max(),
        "win_share": (raced["winner"] == 0).mean(),
        "no_op_share": no_op_share(archive),
        "duplicate_share": duplicate_share(archive),
        "correlation_aggressiveness_restraint": np.corrcoef(found.coordinates.T)[0, 1],
    }
    assert {key: archive.settings[key] for key in facts} == stated(facts)


def test_a_front_is_chosen_on_circuits_of_its_own_and_at_a_calibrated_pace(made):
    """The pace of policies and opponents is at most the calibration of a circuit."""
    search, choice, final = stage_scenarios(TINY)
    assert search.tracks == final.tracks == ("Pipkin", "Tarnfjord", "generated-0")
    assert choice.tracks == ("Brackwater",)
    both = replace(TINY, choice_tracks=("Pipkin", "Brackwater"))
    assert both.circuits(1) == ("Brackwater",)
    assert replace(both, choice_tracks=TINY.tracks).circuits(1) == TINY.tracks
    pace = LATTICE.parameter_names.index("pace")
    assert LATTICE.bounds[pace, 1] > 1.0
    for theta in (made[0].explored_parameters, choice.opponents, final.opponents):
        assert theta[:, pace].max() <= 1.0
    found = circuit("generated-0", TINY.race_rules)
    assert found.content_hash == random_circuit(RandomCircuits(), 0).content_hash
    assert found.calibration["paper"] != random_circuit(RandomCircuits(), 0).calibration["paper"]


def test_policies_far_apart_lie_around_the_champion(spread):
    archive, folder, calls = spread
    check_archive(load_archive(folder))
    assert 3 <= len(archive) <= 4
    settings, explored = archive.settings, archive.explored_parameters
    assert len(explored) == SPREAD.evaluations == 8 + 4 * 4  # both axes up and down
    champion = parse_policy(settings["champion_1"]).parameters
    np.testing.assert_array_equal(explored[0], champion)
    assert any((theta == champion).all() for theta in archive.parameters)
    assert (settings["selection"], settings["margin"]) == ("spread", 0.5)
    stages = list(dict.fromkeys(call[0] for call in calls))
    assert stages == ["champion", "search", "choice", "measurement"]
    final = stage_scenarios(SPREAD, settings["champion_1"])[2]
    assert final.rivals == (*SPREAD.rivals, settings["champion_1"])
    found = summarise(race_policies((final, archive.parameters)))
    np.testing.assert_array_equal(found.coordinates, archive.coordinates)


def test_fixed_parameters_keep_their_values_of_the_start(tmp_path):
    """The search has a dimension less for each; its opponents do not vary them either."""
    start = "lattice:early,blocking=0.25"
    config = replace(TINY, generations=1, start=start, fixed=("pace_behind", "blocking"))
    assert set(LATTICE.parameter_names) - set(config.varied) == {"pace_behind", "blocking"}
    archive = synthesize(config, tmp_path / "made")
    rows, final = LATTICE.indices(config.fixed), stage_scenarios(config)[2]
    for theta in (archive.parameters, archive.explored_parameters, final.opponents):
        np.testing.assert_array_equal(theta[:, rows] - [0.15, 0.25], 0.0)


def test_the_executor_has_no_influence(made, spread, tmp_path):
    with ThreadPoolExecutor(2) as executor:
        for config, folder in ((TINY, made[1]), (SPREAD, spread[1])):
            synthesize(config, tmp_path / config.name, executor=executor)
            assert files(tmp_path / config.name) == files(folder)


def test_limits_leave_out_policies(tmp_path, made):
    """Rules under which many crash, and a least coordinate."""
    wild = tmp_path / "wild.yaml"
    wild.write_text("rules: contest\nname: wild\nspeed_range: [1.2, 1.7]\n")
    config = replace(TINY, rules=str(wild), crash_limit=0.3, generated=0, seed=12)
    archive = synthesize(config, tmp_path / "archive")
    assert (archive.rules, archive.characteristics) == ("wild", ("speed", "reaction"))
    assert (archive.own_crash <= 0.3).all()
    over = archive.explored_own_crash > config.search_crash_limit
    assert archive.settings["search_over_crash_limit"] == over.sum() > 0
    wild.write_text("rules: contest\nname: wild\nspeed_range: [2.0, 3.0]\n")
    hopeless = replace(TINY, rules=str(wild), crash_limit=0.0, tracks=("Tarnfjord",))
    refused(r"all 30 policies|crash limit of 0%", synthesize, hopeless, tmp_path / "none")
    archive = synthesize(replace(TINY, min_coordinates=(0.0, 0.0), seed=7), tmp_path / "least")
    assert archive.coordinates[:, 0].min() > made[0].coordinates[:, 0].min() + 0.2
    assert (archive.explored_coordinates[:, 0] < 0.0).any()


def test_a_measurement_leaves_out_policies_that_score_too_little(monkeypatch, tmp_path):
    real, measured = SpreadRun._race, []

    def race(run, stage, name, scenarios, parameters):
        raced = real(run, stage, name, scenarios, parameters)
        if stage == "measurement":
            raced["winner"][1:], raced["crashed"][1:] = 0, False  # every race won
            raced["winner"][0], raced["crashed"][0] = 1, False  # every race lost
            measured.append(len(parameters))
        return raced

    monkeypatch.setattr(SpreadRun, "_race", race)
    archive = synthesize(replace(SPREAD, margin=0.2), tmp_path / "made")
    assert archive.settings["measurement_outside_limits"] == 1
    assert len(archive) == measured[0] - 1


@pytest.mark.parametrize(
    ("config", "changes", "message"),
    [
        (TINY, {"generations": -1}, "generations is -1"),
        (TINY, {"duration": 5.0}, "duration is 5 s"),
        (TINY, {"duration": 0.9}, r"duration is 0\.9 s"),
        (TINY, {"final_duration": 8.001}, r"final_duration is 8\.001 s"),
        (TINY, {"min_coordinates": (1.0,)}, "min_coordinates is"),
        (TINY, {"min_coordinates": (1.0, "x")}, "min_coordinates is"),
        (TINY, {"start": "spliner"}, "start is 'spliner'; it must be a policy of planner"),
        (TINY, {"fixed": ("speed",)}, "has no parameter 'speed'"),
        (TINY, {"fixed": LATTICE.parameter_names[1:]}, "fixed leaves 1 parameters"),
        (TINY, {"characteristics": ("speed",)}, "characteristics is"),
        (TINY, {"characteristics": ("speed", "charm")}, "characteristic 'charm' is unknown"),
        (TINY, {"rules": "nothing"}, "rules 'nothing' are unknown"),
        (TINY, {"rivals": ("lattice",)}, "unknown archive setting 'rivals'"),
        (SPREAD, {"opponents": 3}, "unknown archive setting 'opponents'"),
        (SPREAD, {"rivals": ()}, "rivals is"),
        (SPREAD, {"rivals": ("nobody",)}, "'nobody' is no planner"),
        (SPREAD, {"max_policies": 2}, "max_policies is 2"),
    ],
)
def test_impossible_settings_are_refused(config, changes, message):
    refused(message, load_archive_config, config, **changes)


def test_a_file_selects_the_kind_of_its_archive(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("selection: spread\nmargin: 0.2\n")
    assert load_archive_config(file).margin == 0.2
    file.write_text("margin: 0.2\n")
    refused("unknown archive setting 'margin'", load_archive_config, file)
    file.write_text("selection: luck\n")
    refused("selection is 'luck'; it must be one of pareto, spread", load_archive_config, file)


def test_the_command(tmp_path, run, told):
    given = ["--config", SETTINGS / "synthesis.yaml", "--track", "Pipkin", "--generations", 0]
    arguments = ["synthesize", *given, "--population", 4, "--out", tmp_path / "a"]
    code, out, err = run(*arguments, "--name", "small")
    assert code == 0
    assert "<PolicyArchive 'small'" in out
    assert f"archive: {tmp_path / 'a'}" in out
    assert "12/12 steps" in err
    code, _, err = run(*arguments, "--name", "other")
    assert code == 2
    assert "its name is 'small', not 'other'" in err
    unknown = told("synthesize", "--config", "nothing", "--out", tmp_path / "b")
    assert "archive settings 'nothing' are unknown; use contest, default or the path" in unknown
    assert not (tmp_path / "b").exists()


@pytest.mark.parametrize("name", ["default", "contest"])
def test_it_was_made_with_the_settings_and_circuits_that_ship(name):
    archive, config = load_archive(name), load_archive_config(name)
    for key, value in stated_settings(config).items():
        # Archives written before the rules had this name state them as the rules.
        stated = archive.settings.get(key, archive.settings.get("rules"))
        assert stated == value, key
    assert len(config.tracks) >= 3
    stated_hashes = archive.settings["track_hashes"].split(", ")
    used = dict.fromkeys(config.circuits(0) + config.circuits(1))
    # The archive contest was also raced on other circuits.
    for track, stated in zip(used, stated_hashes, strict=False):
        assert stated == f"{track} {circuit(track, config.race_rules).content_hash[:16]}"


def test_the_default_archive_lies_along_the_front():
    archive = load_archive("default")
    check_archive(archive)
    assert len(archive) >= 30
    points = archive.normalised
    away = np.linalg.norm(points[:, None] - points[None], axis=-1)[~np.eye(len(points), dtype=bool)]
    assert away.min() > 0.0
    # Seen from either axis there is a policy within a quarter of the range of any place.
    for axis in range(2):
        assert np.diff(np.sort(points[:, axis])).max() < 0.25
    assert np.corrcoef(points.T)[0, 1] < -0.9  # more of one is less of the other
    assert duplicate_share(archive) < 0.15


def test_the_policies_of_the_contest_crash_seldom_and_react_to_the_lead_by_moves_alone():
    archive, config = load_archive("contest"), load_archive_config("contest")
    check_archive(archive)
    assert 8 <= len(archive) <= config.max_policies
    assert (archive.parameters[:, archive.parameter_names.index("pace_behind")] == 0.0).all()
    assert archive.own_crash.max() <= config.crash_limit
    assert no_op_share(archive) <= 0.15
    # The axes nearly lie on one line: the strong policies of the planner differ in pace above all.
    assert np.corrcoef(archive.normalised.T)[0, 1] < -0.85


def test_the_contest_is_measured_again_with_crashes_as_rare_as_they_should_be():
    """Other races of two policies agree with the measurement of the archive."""
    archive = load_archive("contest")
    champion = archive.settings["champion_1"]
    _, _, final = stage_scenarios(load_archive_config("contest", final_starts=4), champion)
    chosen = [0, len(archive) - 1]
    found = summarise(race_policies((final, archive.complete(archive.parameters[chosen]))))
    error = np.abs(found.coordinates - archive.coordinates[chosen])
    assert (error <= 4.0 * archive.spread[chosen]).all()
    np.testing.assert_allclose(found.own_crash, archive.own_crash[chosen], atol=0.05)
    assert load_archive("default").own_crash.max() < 0.15
