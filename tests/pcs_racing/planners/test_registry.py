import copy
import pickle
import sys
from dataclasses import replace
from pkgutil import resolve_name
from types import ModuleType

import numpy as np
import pytest
from refusal import refused

from pcs_racing import racer
from pcs_racing.base.errors import UnknownNameError
from pcs_racing.planners import registry
from pcs_racing.planners.planner import Parameter, Planner
from pcs_racing.planners.registry import get_planner, planner_names, register_planner

PACE = Parameter("pace", 0.0, 1.0, 0.5, "how fast")


@pytest.fixture(autouse=True)
def _own_registry(monkeypatch):
    """Forget the names that a test registers after it."""
    monkeypatch.setattr(registry, "_planners", dict(registry._planners))
    monkeypatch.setattr(registry, "_places", dict(registry._places))


def test_planners_are_found_by_their_names_and_others_are_pickled_whole():
    planner = Planner("mine", (PACE,))
    register_planner(planner)
    register_planner(planner)  # again: nothing happens
    assert get_planner("mine") is planner
    assert "mine" in planner_names()
    refused("planner 'mine' already", register_planner, Planner("mine", (PACE,), memory_size=1))
    refused("planner 'lattice' already", register_planner, Planner("lattice", ()))
    refused("planner 'lattice' already", register_planner, "somewhere.else:LATTICE", name="lattice")
    refused(
        r"planner 'latice' is unknown; did you mean 'lattice'\? there are: .*",
        get_planner,
        "latice",
        error=UnknownNameError,
    )
    for name, place in registry.SHIPPED.items():
        assert get_planner(name).name == name
        assert get_planner(name) is resolve_name(place)
    mine = replace(get_planner("pure-pursuit"), name="pursuit of mine")
    found = pickle.loads(pickle.dumps(mine))
    assert (found.name, found.parameters) == (mine.name, mine.parameters)


def test_a_place_is_imported_when_it_is_needed_or_named(monkeypatch):
    register_planner("a_module_of_mine:PLANNER", name="later")
    assert "later" in planner_names()
    module = ModuleType("a_module_of_mine")
    module.PLANNER = Planner("later", (PACE,))
    monkeypatch.setitem(sys.modules, "a_module_of_mine", module)
    assert get_planner("later") is module.PLANNER
    register_planner("no_such_module:PLANNER", name="absent")
    refused(
        "planner 'absent' can't be loaded from no_such_module:PLANNER: No module",
        get_planner,
        "absent",
    )
    register_planner("math:pi", name="pi")
    refused("planner 'pi': math:pi is of type float", get_planner, "pi")


@pytest.mark.parametrize("name", registry.SHIPPED)
def test_a_planner_with_a_place_is_the_same_one_in_a_copy_and_in_another_process(name):
    """A copy of its functions would be compiled again in every process."""
    policy = racer(name)
    assert pickle.loads(pickle.dumps(policy)).planner is policy.planner
    assert copy.deepcopy(policy).planner is policy.planner
    assert len(pickle.dumps(policy)) < 2000


def test_a_shipped_planner_is_a_file_and_a_line(monkeypatch, tmp_path):
    """With its line in SHIPPED it is listed, made and raced, and the agents' package races it as
    well.
    """
    (tmp_path / "snail_planner.py").write_text(
        "from pcs_racing.planners import Parameter, Planner\n"
        "SNAIL = Planner('snail', (Parameter('pace', 0.0, 1.0, 0.25, 'how fast'),))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(registry._places, "snail", "snail_planner:SNAIL")
    assert "snail" in planner_names()
    assert get_planner("snail").parameter_names == ("pace",)
    assert racer("snail").parameters.tolist() == [0.25]
    assert racer("snail:pace=0.5").name == "snail:pace=0.5"


@pytest.fixture
def example() -> Planner:
    air = Parameter("air", 0.0, 2.0, 1.0, "m")
    planner = Planner("example", (PACE, air), variants={"1": (0.1, 0.1), "brave": (1.0, 0.0)})
    register_planner(planner)
    return planner


def test_a_policy_as_text(example):
    for text, parameters, name in [
        ("example", [0.5, 1.0], "example"),
        ("example:brave", [1.0, 0.0], "example:brave"),
        ("example:1", [0.1, 0.1], "example:1"),
        ("example:air=0.25", [0.5, 0.25], "example:air=0.25"),
        (" example : air = 1e-1, pace = 1", [1.0, 0.1], "example:air=1e-1,pace=1"),
    ]:
        policy = racer(text)
        assert policy.planner is example
        assert policy.parameters.tolist() == parameters
        assert policy.name == name


def test_names_and_policies_that_can_not_be_told_apart_are_one_clear_error(example):
    for text, message in [
        ("", "can't race"),
        (":brave", "':brave' is no planner"),
        ("exampel", "did you mean 'example'"),
        ("example:timid", "no variant 'timid'"),
        ("example:", "no variant ''"),
        ("example:speed=1", "no parameter 'speed'"),
        ("example:pce=1", "did you mean 'pace'"),
        ("example:pace=fast", "pace is 'fast'"),
        ("example:pace=", "pace is ''"),
        ("example:pace=nan", "'pace' is nan"),
        ("example:pace=2", "'pace' is 2"),
        ("example:pace=1,pace=0", "'pace=0' is not of the form name=value, each name once"),
        ("example:pace=1,", "'' is not"),
        ("example:timid,pace=1", "no variant 'timid'"),
        ("example:pace=1,brave", "'brave' is not"),
        (None, "can't race"),
    ]:
        refused(message, racer, text)
    for name in ["", "a:b", "a=b", "a b", "a,b", None]:
        refused("must be text without", register_planner, "module:PLANNER", name=name)


def test_a_variant_with_parameters_changes_only_those():
    policy = racer("lattice:early,pace=0.7")
    early = racer("lattice:early")
    pace = early.planner.parameter_names.index("pace")
    assert policy.name == "lattice:early,pace=0.7"
    assert policy.parameters[pace] == 0.7
    np.testing.assert_array_equal(
        np.delete(policy.parameters, pace), np.delete(early.parameters, pace)
    )
