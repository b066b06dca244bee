import gc
import operator

import numpy as np
import pytest
from numba import njit, types
from numba.core import event, ir
from numba.core.compiler import Flags
from numba.core.registry import cpu_target
from numba.core.types import BaseFunction
from numba.extending import overload

from pcs_racing.base import shorter_compilation
from pcs_racing.base.compilation import compiled


def flags(**values: object) -> Flags:
    made = Flags()
    for name, value in values.items():
        setattr(made, name, value)
    return made


CHOICES = [
    flags(),
    flags(nrt=False),
    flags(nrt=True),
    flags(nrt=True, error_model="numpy"),
    flags(error_model="numpy", nrt=True),
    flags(fastmath=True, nrt=True),
    flags(no_cpython_wrapper=True),
]


@pytest.mark.parametrize("one", CHOICES)
@pytest.mark.parametrize("other", CHOICES)
def test_options_are_equal_where_numba_says_so(one, other):
    assert shorter_compilation.same_options(one, other) is (one == other)
    assert shorter_compilation.hash_of_options(one) == hash(one)
    assert shorter_compilation.same_options(one, "no options") is NotImplemented


def twice(a):
    """Twice a number; compiled code runs what stands below."""
    return 2 * a


@overload(twice)
def _twice(a):
    return lambda a: 2 * a


CALLS = {
    "numbers": (operator.add, types.float64, types.int64),
    "literals": (operator.add, types.literal(2), types.float32),
    "arrays": (np.add, types.Array(types.float64, 1, "C"), types.Array(types.float32, 2, "C")),
    "lists": (operator.add, types.List(types.int64), types.List(types.int64)),
    "compiled": (twice, types.float64),
}


@pytest.fixture
def context():
    cpu_target.typing_context.refresh()
    return cpu_target.typing_context


@pytest.mark.parametrize("name", CALLS)
def test_a_type_found_again_is_the_one_that_numba_finds(context, name):
    function, *arguments = CALLS[name]
    called = context.resolve_value_type(function)
    found = [shorter_compilation.find_type(called, context, tuple(arguments), {}) for _ in range(2)]
    assert found == [called.get_call_type(context, tuple(arguments), {})] * 2


@pytest.mark.parametrize(("name", "kept"), [("numbers", True), ("compiled", False)])
def test_what_numba_has_to_compile_for_a_call_is_not_kept(context, name, kept):
    function, *arguments = CALLS[name]
    called = context.resolve_value_type(function)
    shorter_compilation.find_type(called, context, tuple(arguments), {})
    assert any(which is called for which, _ in shorter_compilation._types_found.values()) is kept


def test_the_variables_of_a_statement_are_those_that_numba_finds():
    here = ir.Loc("nowhere", 1)
    scope = ir.Scope(None, here)
    a, b, c, d = (ir.Var(scope, name, here) for name in "abcd")
    call = ir.Expr.call(a, [b, a], (("named", c),), here)
    for part in (call, [call, d], {"one": (a, [b]), "two": c}, a, "text", ir.Const(1, here)):
        assert shorter_compilation.list_variables(call, part) == call._rec_list_vars(part)


class _Watch(event.Listener):
    """Notes, in every pass of a compilation, whether numba is changed and whether the collector of garbage works."""

    def __init__(self):
        self.changed, self.collects = set(), set()

    def on_start(self, event):
        self.changed.add(BaseFunction.get_call_type is shorter_compilation.find_type)
        self.collects.add(gc.isenabled())

    def on_end(self, event):
        self.on_start(event)


def add(a):
    return a + 1


@pytest.mark.parametrize("collects", [True, False])
@pytest.mark.parametrize(("module", "shorter"), [("pcs_racing.own", True), ("other", False)])
def test_numba_is_changed_while_own_functions_are_compiled(monkeypatch, module, shorter, collects):
    monkeypatch.setattr(add, "__module__", module)
    own = {(owner, name): vars(owner).get(name) for owner, name, _ in shorter_compilation._REPLACED}
    watch, was = _Watch(), gc.isenabled()
    (gc.enable if collects else gc.disable)()
    try:
        with event.install_listener("numba:run_pass", watch):
            assert njit(add)(1) == 2
        assert gc.isenabled() is collects
    finally:
        (gc.enable if was else gc.disable)()
    assert watch.changed == {shorter}
    assert watch.collects == {collects and not shorter}
    assert {(owner, name): vars(owner).get(name) for owner, name, _ in shorter_compilation._REPLACED} == own
    assert not shorter_compilation._types_found


def test_after_a_compilation_that_failed_numba_is_as_before():
    @compiled
    def wrong(a):
        return a.missing

    wrong.py_func.__module__ = "pcs_racing.own"
    own = BaseFunction.get_call_type
    assert gc.isenabled()
    with pytest.raises(Exception, match="missing"):
        wrong(1.0)
    assert gc.isenabled()
    assert BaseFunction.get_call_type is own


def test_without_the_methods_that_it_knows_numba_is_left_alone(monkeypatch):
    monkeypatch.setattr(shorter_compilation, "_REPLACED", ((Flags, "a method of another version", None),))
    monkeypatch.setattr(add, "__module__", "pcs_racing.own")
    assert njit(add)(1) == 2
    assert not hasattr(Flags, "a method of another version")
