"""``python -m studies all``: the steps, skipped steps, and the first failure."""

import pytest
from refusal import refused

from pcs_racing_agents.learning.responses import load_psro_settings
from pcs_racing_agents.policies.config import load_archive_config
from pcs_racing_agents.study.config import load_study_config
from studies import __main__, everything
from studies.everything import GAME, STUDIES, Step, run_steps, steps


@pytest.fixture
def stub(tmp_path, monkeypatch):
    """A module ``stub`` that writes its words into a file, or fails with ``--fail``."""
    (tmp_path / "stub.py").write_text(
        "import pathlib, sys\n"
        "at = sys.argv.index('--out')\n"
        "folder = pathlib.Path(sys.argv[at + 1])\n"
        "folder.mkdir(parents=True, exist_ok=True)\n"
        "if '--fail' in sys.argv: sys.exit(2)\n"
        "with (folder / 'result.txt').open('a') as file: print(*sys.argv[1:], file=file)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return tmp_path / "out"


def step(name, *arguments, **options):
    return Step(name, ("-m", "stub"), arguments, "result.txt", **options)


def test_a_finished_step_is_not_run_again(stub, capfd):
    chosen = [step("archive", "--seed", "1"), step("rows", parallel=False)]
    run_steps(chosen, stub, ["--workers=2"])
    run_steps(chosen, stub, ["--workers=2"])
    out = stub / "archive"
    assert (out / "result.txt").read_text() == f"--seed 1 --out {out} --workers=2\n"
    assert (stub / "rows" / "result.txt").read_text() == f"--out {stub / 'rows'}\n"
    assert "archive: finished" in capfd.readouterr().out


def test_the_first_failure_ends_the_run_and_the_next_run_begins_there(stub):
    run = [step("archive"), step("paper", "--fail"), step("rows")]
    refused("step 'paper' ended with status 2; run the same", run_steps, run, stub, [])
    assert not (stub / "rows").exists()
    run_steps([run[0], step("paper"), run[2]], stub, [])
    assert len((stub / "archive" / "result.txt").read_text().splitlines()) == 1
    assert (stub / "rows" / "result.txt").is_file()


@pytest.mark.parametrize("small", [False, True])
def test_every_step_is_a_command_and_has_a_folder_of_its_own(small, tmp_path, monkeypatch):
    from pcs_racing_agents.cli.main import _parser

    found = steps(tmp_path, tmp_path / "out", small)
    assert len({one.name for one in found}) == len(found)
    monkeypatch.setattr(__main__, "run_parsed", lambda parsed: callable(parsed.run))
    for one in found:
        words = [*one.arguments, "--out", str(tmp_path), *(["--workers=1"] if one.parallel else [])]
        if one.program == GAME:
            assert callable(_parser().parse_args(words).run)
        elif one.program == STUDIES and one.name != "field":
            assert __main__.main(words)
    assert {GAME, STUDIES} <= {one.program for one in found}


def test_a_study_and_trainings_use_the_archive_of_their_rules(tmp_path):
    found = {one.name: one.arguments for one in steps(tmp_path, tmp_path, small=False)}
    for rules, users in (("paper", ["paper", "ppo-paper"]), ("contest", ["contest", "psro"])):
        for name in users:
            at = found[name].index("--archive")
            assert found[name][at + 1] == str(tmp_path / f"archive-{rules}")


def test_unknown_steps_and_folders_without_maps_are_refused(tmp_path, capsys):
    for name in everything.REAL["paper"]:
        (tmp_path / name).mkdir()
    given = ["all", "--maps", str(tmp_path), "--out", str(tmp_path / "out")]
    assert __main__.main([*given, "--step", "row"]) == 2
    assert "did you mean 'rows'?" in capsys.readouterr().err
    given[2] = str(tmp_path / "nowhere")
    assert __main__.main(given) == 2
    assert "lacks the circuits Austin, Monza, Sepang, Zandvoort" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_configurations_of_the_small_run_load():
    assert load_study_config(everything.SMALL / "study.yaml").learning.responses
    assert load_psro_settings(everything.SMALL / "psro.yaml").rounds == 2
    for rules, planner in (("paper", "lattice"), ("contest", "line-ppo")):
        assert load_archive_config(everything.SMALL / f"archive_{rules}.yaml").planner == planner
