"""An argument that several environments take has the same default in each, unless it is listed here."""

import inspect
from collections import defaultdict

import pytest

from pcs_racing.envs.drive import DriveEnv, DriveHeadToHeadEnv, DriveHeadToHeadVectorEnv, DriveVectorEnv
from pcs_racing.envs.duel import DuelEnv, DuelVectorEnv, HeadToHeadEnv
from pcs_racing.envs.match import HeadToHeadMatchEnv, MatchEnv, MatchVectorEnv

SCALAR = (DriveEnv, DuelEnv, MatchEnv, HeadToHeadEnv, HeadToHeadMatchEnv, DriveHeadToHeadEnv)
BATCHES = {
    DriveVectorEnv: DriveEnv,
    DuelVectorEnv: DuelEnv,
    MatchVectorEnv: MatchEnv,
    DriveHeadToHeadVectorEnv: DriveHeadToHeadEnv,
}
DIFFERENT = {"opponent", "time_step", "rivalry"}  # at the level of steering, and where both cars belong to agents


def defaults(kind):
    parameters = inspect.signature(kind).parameters
    return {name: p.default for name, p in parameters.items() if p.default is not inspect.Parameter.empty}


def test_an_argument_has_one_default():
    found = defaultdict(set)
    for kind in SCALAR:
        for name, value in defaults(kind).items():
            found[name].add(repr(value))
    assert {name for name, values in found.items() if len(values) > 1} == DIFFERENT


@pytest.mark.parametrize("kind", BATCHES)
def test_a_batch_has_the_defaults_of_its_environment(kind):
    own, scalar = defaults(kind), defaults(BATCHES[kind])
    assert {name for name in own if name in scalar and own[name] != scalar[name]} == set()
    assert own["num_envs"] == (2 if kind is DriveHeadToHeadVectorEnv else 1)  # one race


def test_what_is_documented_of_the_defaults():
    assert defaults(DriveEnv)["time_step"] == 0.1
    assert defaults(DriveHeadToHeadEnv)["time_step"] == 0.02
    assert {defaults(kind)["render_size"] for kind in SCALAR} == {(960, 640)}
    assert {defaults(kind)["race"] for kind in SCALAR} == {"paper"}


@pytest.mark.parametrize(
    ("kind", "by_place"),
    [
        (DriveEnv, ["track", "opponent", "race"]),
        (DuelEnv, ["track", "archive", "opponent", "race"]),
        (MatchEnv, ["track", "archive", "opponent", "race"]),
        (HeadToHeadEnv, ["track", "archive", "race"]),
        (HeadToHeadMatchEnv, ["track", "archive", "race"]),
        (DriveHeadToHeadEnv, ["track", "race"]),
        (DriveVectorEnv, ["num_envs"]),
        (MatchVectorEnv, ["num_envs"]),
    ],
)
def test_what_may_be_given_by_place(kind, by_place):
    parameters = inspect.signature(kind).parameters
    assert [name for name, p in parameters.items() if p.kind is p.POSITIONAL_OR_KEYWORD] == by_place
    with pytest.raises(TypeError, match="too many positional"):
        kind(*(parameters[name].default for name in by_place), "one more")
    with pytest.raises(TypeError, match=f"multiple values for argument '{by_place[0]}'"):
        kind(parameters[by_place[0]].default, **{by_place[0]: parameters[by_place[0]].default})
