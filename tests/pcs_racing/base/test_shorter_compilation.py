import gc
import operator

import numpy as np
import pytest
from numba import njit, types
from numba.core import event, ir
from numba.core.compiler import Flags
from numba.core.registry import cpu_target
from numba.core.targetconfig import TargetConfig
from numba.extending import overload

from pcs_racing.base import faster_numba
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
    equal = TargetConfig.__eq__(one, other)
    assert (one == other) is equal
    assert (hash(one) == hash(other)) >= equal
    assert one != "no options"


def test_options_of_python_and_of_compiled_code_differ_in_their_hash():
    assert hash(flags(no_cpython_wrapper=True)) != hash(flags())


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
    found = [called.get_call_type(context, tuple(arguments), {}) for _ in range(2)]
    assert found == [faster_numba._numba_finds_type(called, context, tuple(arguments), {})] * 2


@pytest.mark.parametrize(("name", "kept"), [("numbers", True), ("compiled", False)])
def test_what_numba_has_to_compile_for_a_call_is_not_kept(context, name, kept):
    function, *arguments = CALLS[name]
    called = context.resolve_value_type(function)
    called.get_call_type(context, tuple(arguments), {})
    assert any(which is called for which, _ in faster_numba._types_found.values()) is kept


def test_the_variables_of_a_statement_are_those_in_all_its_parts():
    here = ir.Loc("nowhere", 1)
    scope = ir.Scope(None, here)
    a, b, c, d = (ir.Var(scope, name, here) for name in "abcd")
    call = ir.Expr.call(a, [b, a], (("named", c),), here)
    assert call.list_vars() == [a, b, a, c]
    assert ir.Assign(call, d, here).list_vars() == [a, b, a, c, d]
    assert ir.Expr.build_map([(a, b), (c, d)], 2, {}, {}, here).list_vars() == [a, b, c, d]
    assert ir.Assign(ir.Const(1, here), d, here).list_vars() == [d]
    assert ir.Del("a", here).list_vars() == []


class _Watch(event.Listener):
    def __init__(self):
        self.collects = []

    def on_start(self, event):
        self.collects.append(gc.isenabled())

    def on_end(self, event):
        self.collects.append(gc.isenabled())


@pytest.mark.parametrize("collects", [True, False])
def test_the_collector_rests_while_numba_compiles(collects):
    def function(a):
        return a + 1

    watch = _Watch()
    was = gc.isenabled()
    (gc.enable if collects else gc.disable)()
    try:
        with event.install_listener("numba:run_pass", watch):
            assert njit(function)(1) == 2
        assert gc.isenabled() is collects
    finally:
        (gc.enable if was else gc.disable)()
    assert watch.collects
    assert not any(watch.collects)


def test_a_failed_compilation_wakes_the_collector():
    @compiled
    def wrong(a):
        return a.missing

    assert gc.isenabled()
    with pytest.raises(Exception, match="missing"):
        wrong(1.0)
    assert gc.isenabled()
