from dataclasses import replace

import pytest
import yaml
from refusal import refused

from pcs_racing.base.errors import UnknownNameError
from pcs_racing_agents.agents import make_game_spec
from pcs_racing_agents.agents.fits import find_fit, load_fit, make_fit, save_fit
from pcs_racing_agents.agents.zoo import build

PLAN = ["stay", "restraint +", "aggressiveness -", "stay"]
CHOICES = {"best-schedule": PLAN, "best-fixed": 3, "best-lead-plan": {"behind": 7, "ahead": 2}}
OPTIONS = {"best-schedule": "moves", "best-fixed": "target", "best-lead-plan": "targets"}


@pytest.mark.parametrize("kind", CHOICES)
def test_a_fit_is_kept_and_followed(spec, tmp_path, kind, seen):
    fit = make_fit(kind, CHOICES[kind], spec, {"races": 10, "reached": 0.5})
    path = save_fit(fit, tmp_path / "fit.yaml")
    assert vars(load_fit(path)) == vars(fit)
    assert fit.game == spec.identity._replace(elements=(), moves=())
    agent = build(kind, spec, fit=str(path))
    assert agent.facts["trained on"] == "races 10, reached 0.5"
    same = build(kind, spec, **{OPTIONS[kind]: CHOICES[kind]})
    assert (agent.act(seen[0]) == same.act(seen[0])).all()
    assert [entry.name for entry in tmp_path.iterdir()] == ["fit.yaml"]


def test_a_fit_of_another_game_is_refused(spec, archive):
    fit = make_fit("best-fixed", 3, spec, {})
    for change, message in [
        ({"epsilon": 0.7}, "epsilon"),
        ({"moves": 3}, "games of 4 moves; the game has 3"),
    ]:
        refused(
            message,
            find_fit,
            "best-fixed",
            make_game_spec(archive, replace(spec.config, **change)),
            fit,
        )
    fewer = replace(archive, parameters=archive.parameters[1:], coordinates=archive.coordinates[1:])
    refused("was made for archive", find_fit, "best-fixed", make_game_spec(fewer, spec.config), fit)
    refused("is one of 'best-fixed'", find_fit, "best-schedule", spec, fit)
    for kind, option in OPTIONS.items():
        refused(
            f"agent '{kind}' got .* and a fit",
            build,
            kind,
            spec,
            fit=fit,
            **{option: CHOICES[kind]},
        )
    refused(
        "needs 'toy-paper-best-schedule'", find_fit, "best-schedule", spec, error=UnknownNameError
    )


def test_files_that_are_no_fit_are_refused(spec, tmp_path):
    for change, message in [
        ({"kind": "worst"}, "fit of 'worst' is unknown"),
        ({"choice": "7"}, "index of a policy"),
        ({"race": 3}, "race is 3"),
        ({"choice": True}, "index of a policy"),
        ({"epsilon": 0.5}, "epsilon is 0.5; it must be a list"),
        ({"epsilon": ["a"]}, "must be a list of numbers"),
        ({"moves": 0}, "moves is 0"),
        ({"training": [1]}, r"training is \[1\]"),
    ]:
        path = save_fit(make_fit("best-fixed", 3, spec, {}), tmp_path / "fit.yaml")
        path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **change}))
        refused(message, load_fit, path)
