"""A whole study, from trees to the report, in a game of two moves of two seconds."""

import re
import shutil
import tempfile
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from long_jobs import SETTINGS, files
from repository import load_tool

from pcs_racing import InputError, load_archive
from pcs_racing.base.errors import ConfigError, UnknownNameError
from pcs_racing.base.settings import plain_settings
from pcs_racing.game.archive_files import save_archive
from pcs_racing_agents.agents.fits import load_fit, save_fit
from pcs_racing_agents.base.executors import make_executor
from pcs_racing_agents.base.tables import read_csv
from pcs_racing_agents.learning.responses.learner import load_response_settings
from pcs_racing_agents.networks import load_network
from pcs_racing_agents.study import STAGES, StudyConfig, load_study_config, run_study, stages
from pcs_racing_agents.study.config import BEST_OPEN_LOOP, LearningConfig, TableConfig
from pcs_racing_agents.study.report import best_open_loop
from pcs_racing_agents.study.run import stage_seconds, stages_to_run
from pcs_racing_agents.study.study import Study
from pcs_racing_agents.tournament import fitting


def settings_file(name: str, text: str) -> str:
    """A file of settings; one may name another by its path."""
    file = Path(tempfile.mkdtemp(prefix="tiny-study-")) / f"{name}.yaml"
    file.write_text(text, encoding="utf-8")
    return str(file)


SELF_PLAY = settings_file("self_play", "iterations: 2\nstarts: 16\nhidden: [8]\nepochs: 3\n")

AGENTS = ("never-switch", *BEST_OPEN_LOOP, "cfr-argmax", "response-quick")
TABLE = TableConfig(("Pipkin",), ("never-switch", "lane-switcher"), AGENTS, 2, 2, 1)
TINY = load_study_config(
    "quick",
    game={"moves": 2, "step_seconds": 2.0},
    learning=LearningConfig(
        tracks=("Pipkin",),
        trees=3,
        training="quick",
        targets=("advantage",),
        sampled_cfr=SELF_PLAY,
        responses=("response-quick",),
        fitting_races=2,
        ppo=str(SETTINGS / "ppo_duel.yaml"),
    ),
    table=TABLE,
    further=replace(TABLE, opponents=(*TABLE.opponents, "random-moves"), agents=(*AGENTS, "ppo")),
    rating_races=2,
    rated=("never-switch", "cfr-argmax", "ppo", "lane-switcher"),
    seed=3,
)


def learning(**changes) -> StudyConfig:
    """The tiny study with other settings of the learning."""
    return replace(TINY, learning=replace(TINY.learning, **changes))


NAMES = [stage.name for stage in STAGES]


@pytest.fixture(scope="module", autouse=True)
def few_targets():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stages, "FIXED_TARGETS", 2)
        yield


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study") / "tiny"
    return run_study(TINY, folder, quiet=True)


def test_a_study_leaves_its_results_and_a_second_run_repeats_nothing(finished):
    # opponents x arms x (2 egos x 2 variants x 1 line x 2 sides)
    main, further = 2 * 6 * 8, 3 * 7 * 8
    assert len(read_csv(finished.folder / "results.csv").rows()) == main + further
    other = read_csv(finished.folder / "table_further.csv").rows()
    assert {"ppo", "cfr-argmax"} <= {row["arm"] for row in other}
    assert "best-fixed" in (finished.folder / "table.txt").read_text(encoding="utf-8")
    page = (finished.folder / "report.html").read_text(encoding="utf-8")
    assert "<iframe" in page
    assert "https://" not in page.replace("http://www.w3.org", "")
    assert list(stage_seconds(finished)) == NAMES
    results = (finished.folder / "results.csv").read_bytes()
    chunks = {file: file.stat().st_mtime_ns for file in finished.folder.rglob("*.npz")}
    again = run_study(TINY, finished.folder, quiet=True)
    assert (again.folder / "results.csv").read_bytes() == results
    assert {file: file.stat().st_mtime_ns for file in finished.folder.rglob("*.npz")} == chunks


def test_the_report_compares_with_the_best_baseline_in_training(finished):
    compared = best_open_loop(finished)
    table = read_csv(finished.folder / "table.csv").rows()
    assert {row["base"] for row in table if row["kind"] == "adaptivity gain"} == {compared}
    assert f"response-quick - {compared}" in (finished.folder / "table.txt").read_text(
        encoding="utf-8"
    )


def test_the_agents_learned_by_playing_the_game_that_is_studied(finished):
    regrets = load_network(finished.network("regret"))
    assert (regrets.target, regrets.training["sampled"]) == ("regret", True)
    assert "sampled True" in finished.agent("cfr-argmax").facts["trained on"]
    network = load_network(finished.network("ppo"))
    assert network.training["setting_tracks"] == "Pipkin"
    assert network.training["setting_opponents"] == "1 never-switch, 1 lane-switcher:1"
    network.check_fits(finished.game("Pipkin"))  # two moves, not the four of the settings
    curve = read_csv(finished.network("ppo") / "curve.csv").rows()
    assert len({row["steps"] for row in curve}) == 3
    ppo = finished.agent("ppo")
    seen = np.random.default_rng(1).random((50, len(network.identity.elements)), np.float32)
    np.testing.assert_array_equal(ppo.act(seen), network.choose(seen))


def test_another_executor_and_a_stop_change_no_byte(finished, tmp_path):
    other = tmp_path / "other"
    with make_executor("threads", 2) as executor:
        run_study(TINY, other, only=NAMES[: NAMES.index("races")], executor=executor, quiet=True)
        for file in sorted(other.rglob("*.npz"))[::3]:
            file.unlink()  # as if the run had been killed before they were there
        for stage in ("trees", "networks", "sampled-cfr", "open-loop", "responses", "ppo"):
            (other / stage / "done.yaml").unlink()
        run_study(TINY, other, executor=executor, quiet=True)
    one, two = files(finished.folder), files(other)
    assert {"results.csv", "table.csv", "ratings.csv", "networks/ppo/curve.csv"} < set(one)
    assert [name for name in sorted({*one, *two}) if one.get(name) != two.get(name)] == []


def test_changed_files_of_finished_stages_are_named_and_made_again(finished, tmp_path):
    folder = shutil.copytree(finished.folder, tmp_path / "copy")
    half = folder / "networks" / ".response-quick.0123abcd"
    half.mkdir()  # by a run that was killed
    changed = [
        "open-loop/best-fixed.yaml",
        "networks/advantage/weights.safetensors",
        "trees/Pipkin/job.yaml",
    ]
    for name in [*changed, "ratings.csv"]:
        (folder / name).write_bytes(b"other")
        with pytest.raises(
            InputError, match=re.escape(f"{folder / name} is not what stage")
        ) as refused:
            run_study(TINY, folder, quiet=True)
        for file in (name, re.search(r"[\w-]+/done.yaml", str(refused.value))[0]):
            (folder / file).unlink()
    run_study(TINY, folder, quiet=True)
    assert files(folder) == files(finished.folder)
    assert not half.exists()


def test_an_archive_that_was_made_is_the_one_that_ppo_learns_with(tmp_path):
    archive = replace(load_archive("default"), name="mine")
    save_archive(archive, tmp_path / "study" / "archive")
    study = Study(replace(TINY, synthesis="default"), tmp_path / "study", quiet=True)
    stages.train_ppo_baseline(study)
    assert load_network(study.network("ppo")).identity.archive == "mine"
    assert load_network(study.network("ppo")).training["setting_archive"] == "mine"


def test_each_stage_works_on_the_studys_games_with_seeds_of_its_own(tmp_path, monkeypatch):
    """What the stages before the races ask for, of two circuits."""
    circuits = ("Pipkin", "Tarnfjord")
    config = replace(learning(tracks=circuits, seeds=2), seed=2**31 + 3)
    study, asked = Study(config, tmp_path, quiet=True), {}

    def trees(game, folder, **given):
        asked.setdefault("trees", []).append((game.track.name, game.config.stay, folder, given))
        return nullcontext(folder)

    def note(name):
        def called(*given, **named):
            asked[name] = given, named
            raise KeyboardInterrupt

        return called

    monkeypatch.setattr(stages, "open_trees", trees)
    monkeypatch.setattr(
        stages,
        "run_groups",
        lambda groups, **given: asked.update(groups=(groups, given["keep"])),
    )
    stages.play_trees(study)
    drawn = {"pairs": 3, "seeds_per_pair": 2, "one_thread": False}
    assert asked["trees"] == [
        (name, False, tmp_path / "trees" / name, {**drawn, "seed": config.seed + 1_000_000 + k})
        for k, name in enumerate(circuits)
    ]
    assert asked["groups"] == ([tmp_path / "trees" / name for name in circuits], False)
    monkeypatch.setattr(stages, "learn_response", note("response"))
    monkeypatch.setattr("pcs_racing_agents.learning.ppo.train.train_ppo", note("ppo"))
    for stage in (stages.learn_responses, stages.train_ppo_baseline):
        with pytest.raises(KeyboardInterrupt):
            stage(study)
    (games, pool, spec, settings, _), named = asked["response"]
    names = [game.track.name for game in games] + [competitor.name for competitor in pool]
    own = load_response_settings("response-quick")
    assert (names, spec, named["name"], settings) == (
        [*circuits, "never-switch", "random-moves"],
        study.spec,
        "response-quick",
        replace(own, seed=config.seed + 3_000_000 + own.seed),
    )
    (settings, folder), named = asked["ppo"]
    assert (settings.tracks, folder, named["policies"], named["rules"]) == (
        circuits,
        tmp_path / "ppo" / "training",
        study.archive,
        config.game,
    )
    # torch takes none from 2^31 on
    assert named["seeds"] == tuple(3 + seed for seed in settings.seeds)


@pytest.mark.parametrize("number", [3, 10_000])
def test_open_loop_agents_are_fitted_on_training_races_with_targets_spread_over_the_archive(
    tmp_path, monkeypatch, number
):
    study = Study(learning(fitting_opponents=("lane-switcher",)), tmp_path, quiet=True)
    fitted = {}

    def fake(name):
        def fit(training, targets=(), **_):
            fitted[name] = training, targets

        return fit

    monkeypatch.setattr(stages, "FIXED_TARGETS", number)
    for name in ("fixed", "schedule", "lead_plan"):
        monkeypatch.setattr(fitting, f"fit_best_{name}", fake(name))
    monkeypatch.setattr(stages, "save_fit", lambda fit, path: None)
    stages.choose_open_loop(study)
    (training, targets), (_, none), (_, same) = (
        fitted[name] for name in ("fixed", "schedule", "lead_plan")
    )
    assert (none, same) == ((), targets)
    assert len(set(targets or ())) == (3 if number == 3 else 0)
    names = [one.name for one in (*training.tracks, *training.opponents)]
    assert (names, training.races, training.seed) == (["Pipkin", "lane-switcher"], 2, 2_000_003)


def test_what_was_found_can_be_shipped(finished, tmp_path):
    fits = tmp_path / "pcs_racing_agents" / "data" / "fits"
    fits.mkdir(parents=True)
    load_tool("ship_study").ship(finished, tmp_path)
    kinds = ("ppo", "regret", "response", "self-play")
    expected = [f"default-paper-{kind}" for kind in kinds]
    assert sorted(path.name for path in (fits.parent / "networks").iterdir()) == expected
    assert len(list(fits.glob("default-paper-best-*.yaml"))) == 3


def test_the_command_goes_on_in_the_folder_and_says_where_the_results_are(
    finished, tmp_path, printed, told
):
    config = tmp_path / "tiny.yaml"
    config.write_text(yaml.safe_dump(plain_settings(TINY)), encoding="utf-8")
    out = printed("study", config, "--out", finished.folder, "--stage", "archive")
    assert all(re.search(rf"^{stage} +\d+\.\d s$", out, re.MULTILINE) for stage in NAMES)
    assert f"report.html: {finished.folder / 'report.html'}" in out
    assert (finished.folder / "table.txt").read_text(encoding="utf-8") in out
    assert "seed" in told("study", config, "--out", finished.folder, "--seed", 9)


def test_stages_come_in_order():
    with pytest.raises(UnknownNameError, match="stage 'lunch' is unknown"):
        run_study(TINY, "x", only=["lunch"], quiet=True)
    for number, stage in enumerate(STAGES):
        assert set(stage.needs) <= set(NAMES[:number]), stage.name


def test_a_stage_needs_what_others_leave(tmp_path):
    with pytest.raises(InputError, match="stage 'races' needs stage 'networks', which is not done"):
        run_study(TINY, tmp_path / "x", only=["races"], quiet=True)


@pytest.mark.parametrize("better", BEST_OPEN_LOOP)
def test_the_gain_is_over_the_open_loop_agents_that_won_more_training_races(
    finished, tmp_path, better
):
    other = Study(TINY, tmp_path)
    (tmp_path / "open-loop").mkdir()
    for name in BEST_OPEN_LOOP:
        fit = load_fit(finished.folder / "open-loop" / f"{name}.yaml")
        reached = 0.7 if name == better else 0.6
        save_fit(
            replace(fit, training={**fit.training, "reached": reached}),
            tmp_path / "open-loop" / f"{name}.yaml",
        )
    assert best_open_loop(other) == better
    few = replace(TINY, table=replace(TABLE, agents=("never-switch", "response-quick")))
    assert best_open_loop(replace(other, config=few)) is None


def test_impossible_studies_are_refused():
    for changes, message in [
        (
            {"table": {"agents": ("never-switch", "best-fixed", "response-quick")}},
            "not 'best-schedule'",
        ),
        ({"table": {"agents": ("never-switch",)}, "best": "response"}, "best is 'response'"),
        ({"further": {"agents": ("never-switch",)}}, "best is 'response-quick'"),
        ({"table": {"egos": 1}}, "egos is 1"),
        ({"table": {"tracks": ("Pipkin", "Pipkin")}}, "it must be a list of different names"),
        ({"table": {"lunch": 1}}, "unknown table setting 'lunch'"),
        ({"archive": "nowhere"}, "archive is 'nowhere'"),
        ({"game": {"race": {"lunch": 1}}}, "unknown race setting 'lunch'"),
        ({"learning": {"trees": 1}}, "3 trees"),
        ({"game": {"race": {"laps": 2}}}, "laps is 2; game trees need races by time"),
        ({"learning": {"targets": ("fame",)}}, "fame"),
        ({"learning": {"ppo": "drive"}}, "ppo is 'drive'"),
        ({"learning": {"ppo": "nowhere"}}, "ppo settings 'nowhere' are unknown"),
        ({"learning": {"sampled_cfr": "cfr"}}, "one source"),
        ({"lunch": 1}, "unknown study setting 'lunch'"),
    ]:
        with pytest.raises((ConfigError, UnknownNameError), match=message):
            load_study_config("quick", **changes)


def test_shipped_studies_load_and_have_the_open_loop_agents_in_their_main_table():
    for name in ["quick", "paper", "contest"]:
        config = load_study_config(name)
        assert {config.best, *BEST_OPEN_LOOP} <= set(config.table.agents)


@pytest.mark.parametrize(
    ("config", "library", "extra"),
    [
        (learning(ppo=None), "torch", "learning"),
        (replace(TINY, synthesis="default"), "moocore", "synthesis"),
    ],
)
def test_a_missing_library_is_named_before_any_work(monkeypatch, tmp_path, config, library, extra):
    monkeypatch.setattr(
        "pcs_racing.base.errors.find_spec", lambda name: None if name == library else object()
    )
    with pytest.raises(ModuleNotFoundError, match=rf"{library} is needed .*\[{extra}\]"):
        run_study(config, tmp_path / "x", quiet=True)
    monkeypatch.setattr(
        "pcs_racing.base.errors.find_spec",
        lambda name: None if name == "stable_baselines3" else object(),
    )
    with pytest.raises(ModuleNotFoundError, match="stable_baselines3 is needed"):
        run_study(TINY, tmp_path / "x", only=["ppo"], quiet=True)
    assert not (tmp_path / "x").exists()


def test_a_library_is_asked_for_only_by_stages_that_are_still_to_run(monkeypatch, finished):
    monkeypatch.setattr("pcs_racing.base.errors.find_spec", lambda name: None)
    assert [stage.name for stage in stages_to_run(TINY, finished.folder)] == ["report"]
    left = stages_to_run(
        replace(TINY, synthesis="default"), finished.folder / "new", ["races", "trees"]
    )
    assert [stage.name for stage in left] == ["trees", "races"]
