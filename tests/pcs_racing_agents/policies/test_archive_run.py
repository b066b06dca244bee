import csv
import shutil
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from long_jobs import SETTINGS, files
from refusal import refused

from pcs_racing import InputError, load_archive
from pcs_racing.game.moves import duplicate_share, no_op_share
from pcs_racing.planners.lattice import LATTICE
from pcs_racing.testing import check_archive
from pcs_racing_agents.policies.archive_report import front_picture, hypervolume_error
from pcs_racing_agents.policies.archive_run import make_archive, stage_scenarios
from pcs_racing_agents.policies.archive_search import PolicyRaces
from pcs_racing_agents.policies.config import ArchiveConfig, load_archive_config
from pcs_racing_agents.policies.evaluate import Evaluation, race_policies, summarise
from pcs_racing_agents.policies.indicators import hypervolume, non_dominated
from pcs_racing_agents.policies.pareto_archive import Scale
from pcs_racing_agents.policies.selection import front_layers

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
    archive, folder, news = made
    settings = archive.settings
    stated = {
        "tracks": "Pipkin, Tarnfjord",
        "seed": 6,
        "characteristics": "aggressiveness, restraint",
        "fixed": "",
        "min_coordinates": "none",
        "cma_version": version("cma"),
        "moocore_version": version("moocore"),
        "numba_version": version("numba"),
        "numpy_version": np.__version__,
        "enough_policies": True,
        "package_version": version("pcs-racing"),
        "search_over_crash_limit": 0,
        "policies": len(archive),
    }
    stated["search_over_crash_limit"] = np.sum(archive.explored.own_crash > TINY.search_crash_limit)
    assert {key: settings[key] for key in stated} == stated
    assert not {*settings} & {"groups", "payoff_races", "judging_races", "judging_tracks"}
    assert "Tarnfjord " in settings["track_hashes"]
    left_out = sum(
        settings[f"choice_{why}"] for why in ("outside_limits", "beaten", "too_near_another")
    )
    left_out += sum(settings[f"measurement_{why}"] for why in ("over_crash_limit", "beaten"))
    assert settings["choice_candidates"] - left_out == len(archive)
    # The search: the initial sample, whose range is the unit, and three generations. What is done
    # counts by the races.
    explored = archive.explored
    sample = explored.coordinates[:12]
    scale = Scale(sample.max(axis=0), sample.min(axis=0))
    allowed = explored.own_crash <= TINY.search_crash_limit
    assert settings["search_hypervolume"] == pytest.approx(
        hypervolume(scale(explored.coordinates[allowed]), -0.1), rel=1e-5
    )
    everything = hypervolume(scale(explored.coordinates), -0.1)
    assert settings["search_hypervolume_without_crash_limit"] == pytest.approx(everything, rel=1e-5)
    ends, search = [12, 18, 24, 30], [one for one in news if one.stage == "search"]
    assert [(n.generation, n.generations, n.evaluations) for n in search] == [
        (k, 3, end) for k, end in enumerate(ends)
    ]
    crashes = [part.mean() for part in np.split(explored.own_crash, ends[:-1])]
    assert [n.own_crash for n in search] == pytest.approx(crashes)
    first = sample[allowed[:12]]
    assert (search[0].hypervolume, search[0].front) == (
        pytest.approx(hypervolume(scale(first), -0.1)),
        non_dominated(first).sum(),
    )
    volumes = [n.hypervolume for n in news]
    assert volumes == sorted(volumes)  # the same races for all: the front only grows
    # 2 circuits, both sides, opponents, start lines and seconds.
    work = np.array([30 * 4 * 2 * 1 * 4.0, 16 * 4 * 2 * 1 * 4.0, 80 * 4 * 3 * 1 * 8.0])
    assert list(TINY.work.values()) == work.tolist()
    assert [n.done for n in search] == pytest.approx(np.array(ends) / 30 * work[0] / work.sum())
    done = {n.stage: n.done for n in news}
    assert done == pytest.approx(dict(zip(done, np.cumsum(work) / work.sum(), strict=True)))
    assert [n.done for n in news] == sorted(n.done for n in news)
    assert (list(done), news[-1].front) == (["search", "choice", "measurement"], len(archive))
    rows = list(csv.reader((folder / "hypervolume.csv").read_text().splitlines()))
    assert rows == [
        ["generation", "evaluations", "hypervolume", "front", "own_crash"],
        *(
            [
                str(n.generation),
                str(n.evaluations),
                f"{n.hypervolume:.6f}",
                str(n.front),
                f"{n.own_crash:.4f}",
            ]
            for n in search
        ),
    ]


def test_the_coordinates_come_from_races_that_chose_nobody(made):
    """Measured here once more, from the configuration alone; the manifest says what these races
    came to.
    """
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
    sample = archive.explored.coordinates[:12]
    high, low = sample.max(axis=0), sample.min(axis=0)
    rate, winner, count = found.own_crash, raced["winner"], len(archive)
    facts = {
        "policies_not_beaten": np.sum(front_layers(found.coordinates) == 0),
        "hypervolume": hypervolume(Scale(high, low)(found.coordinates), -0.1),
        "hypervolume_error": hypervolume_error(raced, Scale(high, low), -0.1),
        "own_crash_mean": rate.mean(),
        "own_crash_least": rate.min(),
        "own_crash_largest": rate.max(),
        "own_crash_lower_half": rate[: count // 2].mean(),
        "own_crash_most_aggressive_tenth": rate[-max(1, count // 10) :].mean(),
        "finished_against_random": 1.0 - raced["crashed"].mean(),
        "win_share_against_random": (winner == 0).mean(),
        "loss_share_against_random": (winner == 1).mean(),
        "no_op_share": no_op_share(archive),
        "duplicate_share": duplicate_share(archive),
        "correlation_aggressiveness_restraint": np.corrcoef(found.coordinates.T)[0, 1],
    }
    for k, axis in enumerate(TINY.axes):
        facts |= {
            f"ideal_{axis}": found.coordinates[:, k].max(),
            f"nadir_{axis}": found.coordinates[:, k].min(),
        }
        unit = f"0 at {low[k]:.4f}, 1 at {high[k]:.4f} (range of the initial sample)"
        assert archive.settings[f"hypervolume_unit_{axis}"] == unit
    assert {key: archive.settings[key] for key in facts} == {
        key: float(f"{value:.6g}") for key, value in facts.items()
    }


def test_the_error_of_a_hypervolume_is_the_one_that_is_made():
    """Of two policies in 30 pairs of races, which have their luck in common."""
    rng = np.random.default_rng(0)
    volumes, errors = [], []
    for _ in range(60):
        luck = np.repeat(rng.normal(0.0, 0.4, (1, 30, 1)), 2, axis=1)
        segments = rng.integers(1, 3, (2, 60))
        totals = (np.array([[[0.4, 0.8]], [[0.8, 0.4]]]) + luck) * segments[..., None]
        raced = {"totals": totals, "segments": segments}
        points = totals.sum(axis=1) / segments.sum(axis=1)[:, None]
        volumes.append(hypervolume(points, -0.1))
        errors.append(hypervolume_error(raced, Scale(np.ones(2), np.zeros(2)), -0.1))
    assert np.mean(errors) == pytest.approx(np.std(volumes), rel=0.2)


def test_limits_are_violated_by_the_largest_shortfall():
    """Of crashes, of the score against rivals, and of coordinates in units of the initial sample."""
    config = with_(
        crash_limit=0.19, min_score=0.5, rivals=("lane-switcher",), min_coordinates=(1.0, 2.0)
    )
    assert config.search_crash_limit == pytest.approx(0.1)
    assert config.work["search"] == 30 * 2 * (2 + 1) * 2 * 4.0
    assert (config.work["choice"], config.work["measurement"]) == (
        16 * 4 * 3 * 4.0,
        80 * 4 * 4 * 8.0,
    )
    races = PolicyRaces(config, None, None, None, None)
    races.scale = Scale(np.array([10.0, 4.0]), np.array([0.0, 0.0]))
    coordinates = np.array([[2.0, 3.0], [2.0, 3.0], [2.0, 3.0], [0.0, 3.0], [2.0, 1.0]])
    crashes, score = np.array([0.05, 0.3, 0.1, 0.1, 0.1]), np.array([0.6, 0.6, 0.2, 0.5, 0.5])
    evaluation = Evaluation(coordinates, crashes, coordinates, crashes, score)
    assert races.violation(evaluation) == pytest.approx([-0.05, 0.2, 0.3, 0.1, 0.25])
    races.config = with_(crash_limit=0.19)
    assert races.violation(evaluation) == pytest.approx([-0.05, 0.2, 0.0, 0.0, 0.0])


def test_the_picture_of_an_archive_shows_the_front_with_its_errors(made):
    pytest.importorskip("matplotlib")
    archive = replace(made[0], own_crash=np.linspace(0.0, 0.3, len(made[0])))
    figure = front_picture(archive)
    plot, bar = figure.axes
    points, spread = archive.coordinates[:, ::-1], archive.spread[:, ::-1]
    together = np.corrcoef(points.T)[0, 1]
    assert (
        plot.get_title("left")
        == f"archive tiny, preset paper; bars: one standard error; correlation {together:+.2f}"
    )
    assert (plot.get_xlabel(), plot.get_ylabel()) == ("restraint (s)", "aggressiveness (m)")
    assert [text.get_text() for text in plot.get_legend().get_texts()] == [
        "30 explored",
        f"{len(archive)} policies",
    ]
    dots, (across, upright) = (
        plot.collections[-1],
        [c for c in plot.collections if hasattr(c, "get_segments")],
    )
    drawn = plot.lines[0].get_xydata(), dots.get_offsets(), dots.get_array()
    for found, expected in zip(
        drawn,
        (archive.explored.coordinates[:, ::-1], points, 100.0 * archive.own_crash),
        strict=True,
    ):
        np.testing.assert_array_equal(found, expected)
    ends = [[(points[:, k] - spread[:, k]), (points[:, k] + spread[:, k])] for k in (0, 1)]
    for k, lines in enumerate((across, upright)):
        np.testing.assert_allclose(np.array(lines.get_segments())[:, :, k].T, ends[k])
    assert bar.get_ylabel() == "own crashes in % of the measuring races"


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
    for policies in (
        complete(archive.parameters),
        complete(archive.explored_parameters),
        final.opponents,
    ):
        np.testing.assert_array_equal(
            policies[:, rows], np.tile(LATTICE.default[rows], (len(policies), 1))
        )
    found = summarise(race_policies((final, archive.complete(archive.parameters))))
    np.testing.assert_array_equal(found.coordinates, archive.coordinates)


@pytest.mark.parametrize("kind", ["threads", "processes"])
def test_the_executor_has_no_influence(made, tmp_path, kind, executor):
    make_archive(TINY, tmp_path / "again", executor=executor)
    assert files(tmp_path / "again") == files(made[1])


def test_a_finished_run_races_nothing_again_and_other_folders_are_left_alone(
    made, monkeypatch, tmp_path
):
    folder = Path(shutil.copytree(made[1], tmp_path / "copy"))
    monkeypatch.setattr("pcs_racing_agents.policies.evaluate.advance", None)
    # of a run that was killed while it wrote
    (folder / ".archive.npz.0123abcd").write_bytes(b"half")
    again = make_archive(TINY, folder)
    np.testing.assert_array_equal(again.coordinates, made[0].coordinates)
    assert files(folder) == files(made[1])
    shipped = Path(
        shutil.copytree(made[1], tmp_path / "shipped", ignore=shutil.ignore_patterns("job"))
    )
    before = files(shipped)
    refused(r"archive\.npz but no run", make_archive, TINY, shipped)
    assert files(shipped) == before
    assert len(list(shipped.iterdir())) == len(before)
    before = files(made[1])
    refused("generations is 3, not 4", make_archive, with_(generations=4), made[1])
    assert files(made[1]) == before


def test_a_crash_limit_leaves_out_those_that_crash(tmp_path, made):
    """Rules under which many crash; the limit is for the longer races, so it is lower for the
    shorter ones.
    """
    wild = tmp_path / "wild.yaml"
    wild.write_text("preset: contest\nname: wild\nspeed_range: [1.2, 1.7]\n")
    config = with_(preset=str(wild), crash_limit=0.3, seed=12)
    assert config.search_crash_limit == pytest.approx(1.0 - 0.7**0.5)
    assert config.axes == ("speed", "reaction")
    archive = make_archive(config, tmp_path / "archive")
    assert (archive.own_crash <= 0.3).all()
    over = np.sum(archive.explored.own_crash > config.search_crash_limit)
    assert archive.settings["search_over_crash_limit"] == over > 0
    assert (
        archive.settings["search_hypervolume"]
        < archive.settings["search_hypervolume_without_crash_limit"]
    )
    assert archive.preset == "wild"
    wild.write_text("preset: contest\nname: wild\nspeed_range: [2.0, 3.0]\n")
    with pytest.raises(InputError, match=r"all 30 policies|crash limit of 0%"):
        make_archive(
            with_(preset=str(wild), crash_limit=0.0, tracks=("Tarnfjord",)), tmp_path / "none"
        )


def test_policies_below_the_least_coordinates_stay_out_and_too_few_are_told(tmp_path, made, caplog):
    archive = make_archive(with_(min_coordinates=(0.0, 0.0), seed=7), tmp_path / "least")
    assert archive.coordinates[:, 0].min() > made[0].coordinates[:, 0].min() + 0.2
    assert (archive.explored.coordinates[:, 0] < 0.0).any()
    archive = make_archive(with_(min_policies=60, crash_limit=0.0), tmp_path / "few")
    assert not archive.own_crash.any()
    assert f"the archive holds {len(archive)} policies; 60 were wanted" in caplog.text
    assert archive.settings["enough_policies"] is False


def test_impossible_settings_are_refused():
    for changes, message in [
        ({"generations": -1}, "generations is -1"),
        ({"duration": 5.0}, "duration is 5 s"),
        ({"min_coordinates": (1.0,)}, "min_coordinates is"),
        ({"min_coordinates": (1.0, "x")}, "min_coordinates is"),
        ({"min_policies": 81}, "min_policies is 81, above max_policies, 80"),
        ({"min_score": 0.1}, r"min_score is 0\.1, but there are no rivals"),
        ({"duration": 0.9}, r"duration is 0\.9 s"),
        ({"final_duration": 8.001}, r"final_duration is 8\.001 s"),
        ({"fixed": ("speed",)}, "has no parameter 'speed'"),
        ({"fixed": LATTICE.parameter_names}, "fixed names all parameters"),
        ({"characteristics": ("charm",)}, "characteristic 'charm' is unknown"),
        ({"preset": "nothing"}, "race settings 'nothing' are unknown"),
        ({"speed": 3}, "unknown archive setting 'speed'"),
    ]:
        refused(message, with_, **changes)


def test_the_command(tmp_path, run, told):
    arguments = [
        "synthesize",
        "--config",
        SETTINGS / "synthesis.yaml",
        "--track",
        "Pipkin",
        "--generations",
        0,
    ]
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
