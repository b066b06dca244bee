"""A whole study, from trees to the report, in a game of two moves of two seconds."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
import yaml
from long_jobs import files
from refusal import refused
from repository import load_tool

from pcs_racing.base.errors import ConfigError, UnknownNameError
from pcs_racing.base.settings import plain_settings
from pcs_racing_agents.agents.blind import load_fit, save_fit
from pcs_racing_agents.base.tables import read_csv
from pcs_racing_agents.learning.responses import load_response_settings
from pcs_racing_agents.networks import load_network
from pcs_racing_agents.study import StudyConfig, load_study_config, run, run_study
from pcs_racing_agents.study.config import BASELINES, LearningConfig, TableConfig
from pcs_racing_agents.study.report import best_baseline
from pcs_racing_agents.study.study import Study

AGENTS = ("never-switch", *BASELINES, "cfr-argmax", "response-quick")
TABLE = TableConfig(("Pipkin",), ("never-switch", "lane-switcher:any"), AGENTS, 2, 2, 1)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory) -> StudyConfig:
    self_play = tmp_path_factory.mktemp("tiny") / "self_play.yaml"
    self_play.write_text("iterations: 2\nstarts: 16\nhidden: [8]\nepochs: 3\n")
    return load_study_config(
        "quick",
        rules={"steps": (2.0,) * 3},
        learning=LearningConfig(
            tracks=("Pipkin",),
            trees=3,
            training="quick",
            targets=("advantage",),
            sampled_cfr=str(self_play),
            responses=("response-quick",),
            fitting_races=2,
        ),
        table=TABLE,
        further=replace(TABLE, opponents=(*TABLE.opponents, "random-moves")),
        seed=3,
    )


@pytest.fixture(scope="module", autouse=True)
def few_targets():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "FIXED_TARGETS", 2)
        yield


@pytest.fixture(scope="module")
def finished(tiny, tmp_path_factory):
    return run_study(tiny, tmp_path_factory.mktemp("study") / "tiny", quiet=True)


def test_a_study_leaves_its_results_and_a_second_run_repeats_nothing(finished):
    # opponents x agents x (2 egos x 2 variants x 1 line x 2 sides)
    folder = finished.folder
    assert len(read_csv(folder / "results.csv").rows()) == 2 * 6 * 8 + 3 * 6 * 8
    assert {row["opponent"] for row in read_csv(folder / "table_further.csv").rows()} == {
        *TABLE.opponents,
        "random-moves",
    }
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "All findings" in page
    # The gain is over the best baseline in training.
    gains = [row for row in read_csv(folder / "table.csv").rows() if "gain" in row["kind"]]
    assert {row["base"] for row in gains} == {best_baseline(finished)}
    before = files(folder)
    chunks = {file: file.stat().st_mtime_ns for file in folder.rglob("*.npz")}
    run_study(finished.config, folder, quiet=True)
    assert files(folder) == before
    assert {file: file.stat().st_mtime_ns for file in folder.rglob("*.npz")} == chunks


def test_the_agents_learned_by_playing_the_game_that_is_studied(finished):
    regrets = load_network(finished.network("regret"))
    assert (regrets.target, regrets.training["sampled"]) == ("regret", True)
    regrets.check_fits(finished.game("Pipkin"))
    assert "sampled True" in finished.agent("cfr-argmax").facts["trained on"]
    assert finished.agent("response-quick").name == "response-quick"


def test_another_executor_and_a_stop_change_no_byte(finished, tmp_path):
    other = tmp_path / "other"
    with ThreadPoolExecutor(2) as executor:
        run_study(finished.config, other, executor=executor, quiet=True)
        for file in sorted(other.rglob("*.npz"))[::3]:
            file.unlink()  # as if the run had been killed before they were there
        (other / "networks" / "advantage" / "learning_curves.csv").unlink()
        half = other / "networks" / ".response-quick.0123abcd"
        half.mkdir()  # by a run that was killed
        run_study(finished.config, other, executor=executor, quiet=True)
    assert not half.exists()
    one, two = files(finished.folder), files(other)
    assert {"results.csv", "table.csv", "networks/regret/manifest.yaml"} < set(one)
    assert [name for name in sorted({*one, *two}) if one.get(name) != two.get(name)] == []


def test_each_stage_works_on_the_studys_games_with_seeds_of_its_own(tiny, tmp_path, monkeypatch):
    """Trees and responses, of two circuits."""
    circuits = ("Pipkin", "Tarnfjord")
    learning = replace(tiny.learning, tracks=circuits, targets=())
    study = Study(replace(tiny, learning=learning), tmp_path, quiet=True)
    trees, asked = [], {}

    def build(game, folder, **given):
        trees.append((game.track.name, game.rules.stay, folder, given["pairs"], given["seed"]))

    def learn(games, pool, spec, settings, job, **given):
        asked.update(games=[game.track.name for game in games], settings=settings)
        asked.update(pool=[competitor.name for competitor in pool])
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "build_trees", build)
    run.train_networks(study)
    assert trees == []  # no targets, no trees
    config = replace(study.config, learning=replace(learning, targets=("nash",)))
    with pytest.raises(TypeError):
        run.train_networks(replace(study, config=config))
    seeds = (3 + 1_000_000, 3 + 1_000_001)
    assert trees == [
        (name, False, tmp_path / "trees" / name, 3, seed)
        for name, seed in zip(circuits, seeds, strict=True)
    ]
    monkeypatch.setattr(run, "learn_response", learn)
    with pytest.raises(KeyboardInterrupt):
        run.learn_responses(study)
    own = load_response_settings("response-quick")
    assert asked == {
        "games": list(circuits),
        "pool": ["never-switch", "random-moves"],
        "settings": replace(own, seed=3 + 3_000_000 + own.seed),
    }


@pytest.mark.parametrize("number", [3, 10_000])
def test_baselines_are_fitted_on_training_races_with_targets_spread_over_the_archive(
    tiny, tmp_path, monkeypatch, number
):
    learning = replace(tiny.learning, fitting_opponents=("lane-switcher:any",))
    study = Study(replace(tiny, learning=learning), tmp_path, quiet=True)
    fitted = {}

    def fake(name):
        def fit(training, targets=(), **_):
            fitted[name] = training, targets

        return fit

    monkeypatch.setattr(run, "FIXED_TARGETS", number)
    for name in ("fixed", "schedule", "lead_plan"):
        monkeypatch.setattr(run, f"fit_best_{name}", fake(name))
    monkeypatch.setattr(run, "save_fit", lambda fit, path: None)
    run.fit_baselines(study)
    (training, targets), (_, none), (_, same) = (
        fitted[name] for name in ("fixed", "schedule", "lead_plan")
    )
    assert (none, same) == ((), targets)
    assert len(set(targets or ())) == (3 if number == 3 else 0)
    names = [one.name for one in (*training.tracks, *training.opponents)]
    assert (names, training.races, training.seed) == (["Pipkin", "lane-switcher:any"], 2, 2_000_003)


@pytest.mark.parametrize("better", BASELINES)
def test_the_gain_is_over_the_baseline_with_more_wins_in_training(finished, tmp_path, better):
    other = replace(finished, folder=tmp_path)
    other.fit("").parent.mkdir()
    for name in BASELINES:
        fit = load_fit(finished.fit(name))
        training = {**fit.training, "reached": 0.7 if name == better else 0.6}
        save_fit(replace(fit, training=training), other.fit(name))
    assert best_baseline(other) == better
    # A subset of the baselines would pass the best of the subset off as the best one.
    few = replace(TABLE, agents=("never-switch", "best-fixed", "response-quick"))
    assert best_baseline(replace(other, config=replace(other.config, table=few))) is None


def test_what_was_found_can_be_shipped(finished, tmp_path):
    fits = tmp_path / "pcs_racing_agents" / "data" / "fits"
    fits.mkdir(parents=True)
    load_tool("ship_study").ship(finished, tmp_path)
    expected = [f"default-paper-{kind}" for kind in ("regret", "response", "self-play")]
    assert sorted(path.name for path in (fits.parent / "networks").iterdir()) == expected
    assert len(list(fits.glob("default-paper-best-*.yaml"))) == 3


def test_the_command_resumes_in_the_folder_and_says_where_the_results_are(
    finished, tmp_path, printed, told
):
    config = tmp_path / "tiny.yaml"
    config.write_text(yaml.safe_dump(plain_settings(finished.config)), encoding="utf-8")
    out = printed("study", config, "--out", finished.folder)
    assert f"report.html: {finished.folder / 'report.html'}" in out
    assert (finished.folder / "table.txt").read_text(encoding="utf-8") in out
    assert "seed" in told("study", config, "--out", finished.folder, "--seed", 9)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"table": {"agents": ("never-switch",)}, "best": "response"}, "best is 'response'"),
        ({"further": {"agents": ("never-switch",)}}, "best is 'response-quick'"),
        ({"table": {"egos": 1}}, "egos is 1"),
        ({"table": {"tracks": ("Pipkin", "Pipkin")}}, "it must be a list of different names"),
        ({"table": {"lunch": 1}}, "unknown table setting 'lunch'"),
        ({"table": 5}, "table is 5"),
        ({"archive": "nowhere"}, "archive is 'nowhere'"),
        ({"rules": {"lunch": 1}}, "unknown rules setting 'lunch'"),
        ({"learning": {"trees": 1}}, "trees is 1"),
        ({"rules": {"laps": 2}}, "laps is 2; game trees need races by time"),
        ({"learning": {"targets": ("fame",)}}, "fame"),
        ({"learning": {"sampled_cfr": "cfr"}}, "one source"),
        ({"lunch": 1}, "unknown study setting 'lunch'"),
    ],
)
def test_impossible_studies_are_refused(changes, message):
    with pytest.raises((ConfigError, UnknownNameError), match=message):
        load_study_config("quick", **changes)


@pytest.mark.parametrize("name", ["quick", "paper", "contest"])
def test_shipped_studies_have_the_baselines_in_their_main_table(name):
    config = load_study_config(name)
    assert {config.best, *BASELINES} <= set(config.table.agents)


def test_a_missing_library_or_track_is_named_before_any_work(tiny, monkeypatch, tmp_path):
    elsewhere = replace(tiny, table=replace(TABLE, tracks=("Nowhere",)))
    refused("Nowhere", run_study, elsewhere, tmp_path / "x", quiet=True)
    monkeypatch.setattr("pcs_racing.base.errors.find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match=r"torch is needed .*\[learning\]"):
        run_study(tiny, tmp_path / "x", quiet=True)
    assert not (tmp_path / "x").exists()
