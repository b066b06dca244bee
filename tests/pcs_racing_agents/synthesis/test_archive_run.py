import csv
import shutil
from pathlib import Path

import numpy as np
import pytest
from long_jobs import SETTINGS, files
from refusal import refused

from pcs_racing import InputError, load_archive
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.testing import check_archive
from pcs_racing_agents.synthesis.archive_run import make_archive, stage_scenarios
from pcs_racing_agents.synthesis.config import ArchiveConfig, load_archive_config
from pcs_racing_agents.synthesis.evaluate import race_policies, summarise
from pcs_racing_agents.synthesis.selection import front_layers

pytest.importorskip("cma")
pytest.importorskip("moocore")

TINY = ArchiveConfig(
    name="tiny", tracks=("Pipkin", "Tarnfjord"), duration=4.0, final_duration=8.0, segment_seconds=2.0,
    generations=3, population=6, initial_sample=12, opponents=2, starts=1, crash_limit=0.4, candidates=16,
    choice_opponents=2, choice_starts=1, final_opponents=3, final_starts=1, min_policies=2, seed=6,
)  # fmt: skip


def with_(**changes) -> ArchiveConfig:
    return load_archive_config(TINY, **changes)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """An archive, its folder, and the news told on the way."""
    folder, news = tmp_path_factory.mktemp("archive") / "made", []
    return make_archive(TINY, folder, callback=news.append), folder, news


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


def test_the_manifest_and_the_curve_say_how_it_was_made(made):
    settings = made[0].settings
    assert settings["tracks"] == "Pipkin, Tarnfjord"
    assert "Tarnfjord " in settings["track_hashes"]
    assert settings["seed"] == 6
    assert settings["package_version"]
    assert settings["characteristics"] == "aggressiveness, restraint"
    left_out = sum(settings[f"choice_{why}"] for why in ("outside_limits", "beaten", "too_near_another"))
    left_out += sum(settings[f"measurement_{why}"] for why in ("over_crash_limit", "beaten"))
    assert settings["choice_candidates"] - left_out == len(made[0])
    assert settings["policies_not_beaten"] == np.sum(front_layers(made[0].coordinates) == 0)
    assert settings["hypervolume_error"] > 0.0
    together = np.corrcoef(made[0].coordinates.T)[0, 1]
    assert settings["correlation_aggressiveness_restraint"] == pytest.approx(together, abs=1e-5)
    _, folder, news = made
    assert [n.generation for n in news if n.stage == "search"] == [0, 1, 2, 3]
    assert [n.stage for n in news if n.stage != "search"] == sorted(n.stage for n in news if n.stage != "search")
    assert [n.done for n in news] == sorted(n.done for n in news)
    assert news[-1].done == 1.0
    volumes = [n.hypervolume for n in news]
    assert volumes == sorted(volumes)  # the same races for all: the front only grows
    assert news[-1].front == len(made[0])
    rows = list(csv.DictReader((folder / "hypervolume.csv").read_text().splitlines()))
    assert [int(row["evaluations"]) for row in rows] == [12, 18, 24, 30]
    assert [float(row["hypervolume"]) for row in rows] == pytest.approx(volumes[:4], abs=1e-6)


def test_the_coordinates_come_from_races_that_chose_nobody(made):
    """Measured here once more, from the configuration alone."""
    archive = made[0]
    search, choice, final = stage_scenarios(TINY)
    assert final.config.duration == 8.0
    for earlier in (search, choice):
        assert not np.isin(final.seed, earlier.seed).any()
        assert not (final.opponents[:, None] == earlier.opponents[None]).all(axis=-1).any()
    found = summarise(race_policies((final, archive.parameters)))
    np.testing.assert_array_equal(found.coordinates, archive.coordinates)
    np.testing.assert_array_equal(found.spread, archive.spread)
    np.testing.assert_array_equal(found.own_crash, archive.own_crash)


def test_fixed_parameters_keep_their_defaults_and_are_left_out(tmp_path):
    """The search has a dimension less for each; its opponents do not vary them either."""
    config = with_(generations=1, fixed=("pace_behind", "blocking"))
    archive = make_archive(config, tmp_path / "made")
    assert archive.parameter_names == config.varied
    assert set(LATTICE.parameter_names) - set(config.varied) == {"pace_behind", "blocking"}
    assert archive.settings["fixed"] == "pace_behind, blocking"
    rows = LATTICE.indices(config.fixed)
    final = stage_scenarios(config)[2]
    complete = archive.complete
    for policies in (complete(archive.parameters), complete(archive.explored_parameters), final.opponents):
        np.testing.assert_array_equal(policies[:, rows], np.tile(LATTICE.default[rows], (len(policies), 1)))
    found = summarise(race_policies((final, archive.complete(archive.parameters))))
    np.testing.assert_array_equal(found.coordinates, archive.coordinates)


@pytest.mark.parametrize("kind", ["threads", "processes"])
def test_the_executor_has_no_influence(made, tmp_path, kind, executor):
    make_archive(TINY, tmp_path / "again", executor=executor)
    assert files(tmp_path / "again") == files(made[1])


def test_a_finished_run_races_nothing_again_and_other_folders_are_left_alone(made, monkeypatch, tmp_path):
    folder = Path(shutil.copytree(made[1], tmp_path / "copy"))
    monkeypatch.setattr("pcs_racing_agents.synthesis.evaluate.advance", None)
    again = make_archive(TINY, folder)
    np.testing.assert_array_equal(again.coordinates, made[0].coordinates)
    assert files(folder) == files(made[1])
    shipped = Path(shutil.copytree(made[1], tmp_path / "shipped", ignore=shutil.ignore_patterns("job")))
    before = files(shipped)
    refused(r"archive\.npz but no run", make_archive, TINY, shipped)
    assert files(shipped) == before
    assert len(list(shipped.iterdir())) == len(before)
    before = files(made[1])
    refused("generations is 3, not 4", make_archive, with_(generations=4), made[1])
    assert files(made[1]) == before


def test_a_crash_limit_leaves_out_those_that_crash(tmp_path, made):
    """Rules under which many crash; the limit is for the longer races, so it is lower for the shorter ones."""
    wild = tmp_path / "wild.yaml"
    wild.write_text("preset: contest\nname: wild\nspeed_range: [1.2, 1.7]\n")
    config = with_(preset=str(wild), crash_limit=0.3, seed=12)
    assert config.search_crash_limit == pytest.approx(1.0 - 0.7**0.5)
    assert config.axes == ("speed", "reaction")
    archive = make_archive(config, tmp_path / "archive")
    assert (archive.own_crash <= 0.3).all()
    over = np.sum(archive.explored.own_crash > config.search_crash_limit)
    assert archive.settings["search_over_crash_limit"] == over > 0
    assert archive.settings["search_hypervolume"] < archive.settings["search_hypervolume_without_crash_limit"]
    assert archive.preset == "wild"
    wild.write_text("preset: contest\nname: wild\nspeed_range: [2.0, 3.0]\n")
    with pytest.raises(InputError, match=r"all 30 policies|crash limit of 0%"):
        make_archive(with_(preset=str(wild), crash_limit=0.0, tracks=("Tarnfjord",)), tmp_path / "none")


def test_policies_below_the_least_coordinates_stay_out_and_too_few_are_told(tmp_path, made, caplog):
    archive = make_archive(with_(min_coordinates=(0.0, 0.0), seed=7), tmp_path / "least")
    assert archive.coordinates[:, 0].min() > made[0].coordinates[:, 0].min() + 0.2
    assert (archive.explored.coordinates[:, 0] < 0.0).any()
    archive = make_archive(with_(min_policies=60), tmp_path / "few")
    assert f"the archive holds {len(archive)} policies; 60 were wanted" in caplog.text
    assert archive.settings["enough_policies"] is False


def test_impossible_settings_are_refused():
    for changes, message in [
        ({"generations": -1}, "generations is -1"),
        ({"duration": 5.0}, "duration is 5 s"),
        ({"min_coordinates": (1.0,)}, "min_coordinates is"),
        ({"min_coordinates": (1.0, "x")}, "min_coordinates is"),
        ({"min_policies": 90}, "min_policies is 90"),
        ({"fixed": ("speed",)}, "has no parameter 'speed'"),
        ({"fixed": LATTICE.parameter_names}, "fixed names all parameters"),
        ({"characteristics": ("charm",)}, "characteristic 'charm' is unknown"),
        ({"preset": "nothing"}, "race settings 'nothing' are unknown"),
        ({"speed": 3}, "unknown archive setting 'speed'"),
    ]:
        refused(message, with_, **changes)


def test_the_command(tmp_path, run, told):
    arguments = ["synthesize", "--config", SETTINGS / "synthesis.yaml", "--track", "Pipkin", "--generations", 0]
    arguments += ["--population", 4, "--out", tmp_path / "a"]
    code, out, err = run(*arguments, "--name", "small", "--executor", "serial")
    assert code == 0
    assert "<PolicyArchive 'small'" in out
    assert f"archive: {tmp_path / 'a'}" in out
    assert "measurement: generation 0/0, hypervolume " in err
    assert load_archive(tmp_path / "a").name == "small"
    code, _, err = run(*arguments, "--name", "other")
    assert code == 2
    assert "its name is 'small', not 'other'" in err
    unknown = told("synthesize", "--config", "nothing", "--out", tmp_path / "b")
    assert "archive settings 'nothing' are unknown; use contest, default or the path" in unknown
    assert not (tmp_path / "b").exists()
