"""Shorter compilation: what numba works out again and again while it compiles, worked out once.

Four fifths of the processor time that numba takes to compile the kernels of a race is spent in its own Python code, not
in LLVM. A good third of the whole went into a few things that have no say in the machine code and for which numba has
no setting. They are replaced here, in all compilation of this process:

* Numba looks up its own helper functions by the types of their arguments and by the options (`Flags`) of the caller.
  All options had the same hash, and two of them were compared by two dictionaries of all their values, 70,000 times
  before the first race.
* An addition, a comparison or an index was given its type anew wherever it stands in a kernel: all ways in which numba
  knows to add (numbers, strings, lists, arrays, ...) were tried until one fitted the types.
* Two events were announced for each call of LLVM, 50,000 before the first race, to measure how long its lock is held
  (``llvm_lock`` among the timers of ``get_metadata``, which is now 0).
* The variables of each statement are listed again after every pass, which called a method for each part of it.
* Python's collector of cyclic garbage looked through objects that all stay in use.

``benchmarks/start_time.py --against`` compares two versions of this package.
"""

import gc
from typing import Any

from llvmlite.binding import ffi
from numba.core import event
from numba.core.compiler import Flags
from numba.core.ir import Inst, Var
from numba.core.types import BaseFunction

__all__ = ["announces_lock", "find_type", "hash_flags", "list_variables", "same_flags"]

_numba_finds_type = BaseFunction.get_call_type

_types_found: dict[tuple[Any, ...], tuple[Any, Any]] = {}
"""Of a function (by its id, as its hash is slow), a context and argument types: the function, and the signature."""


def hash_flags(flags: Any) -> int:
    """Hash of options of compilation, of those alone in which our functions differ."""
    return hash((flags.nrt, flags.no_cpython_wrapper, flags.error_model))


def same_flags(flags: Any, other: object) -> Any:
    """Whether all options are equal; one that is not set has its default value."""
    if not isinstance(other, Flags):
        return NotImplemented
    own, others = flags._values, other._values
    if own == others:
        return True
    return all(getattr(flags, name) == getattr(other, name) for name in own.keys() | others.keys())


def find_type(function: Any, context: Any, arguments: Any, named: Any) -> Any:
    """Signature of a call of one of numba's own functions, kept where nothing had to be compiled to find it.

    What numba has to compile for a call depends on the options of the caller, too.
    """
    if named:
        return _numba_finds_type(function, context, arguments, named)
    key = id(function), id(context), tuple(arguments)
    if key in _types_found:
        return _types_found[key][1]
    signature = _numba_finds_type(function, context, arguments, named)
    if signature is not None and function.get_impl_key(signature) is function.typing_key:
        _types_found[key] = function, signature  # as long as it is kept here, its id is not given to another
    return signature


def list_variables(statement: Inst, part: Any) -> list[Var]:
    """Variables in a part of a statement: in an instruction, or in a list, tuple or dictionary of parts."""
    if isinstance(part, Inst):
        return part.list_vars()
    if isinstance(part, dict):
        part = part.values()
    elif not isinstance(part, list | tuple):
        return [part] if isinstance(part, Var) else []
    found = []
    for each in part:
        if type(each) is Var:
            found.append(each)
        elif isinstance(each, Inst | list | tuple | dict):
            found += list_variables(statement, each)
    return found


def announces_lock(callbacks: Any) -> bool:
    """Whether a pair of callbacks is the one by which numba measures how long the lock of LLVM is held."""
    return bool(callbacks[0].__module__ == "numba.core.base")


class _Collector(event.Listener):
    """Lets Python's collector rest while numba compiles, which it does in one thread at a time."""

    def __init__(self) -> None:
        self.depth = 0
        self.collects = False

    def on_start(self, event: Any) -> None:
        if self.depth == 0:
            self.collects = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, event: Any) -> None:
        self.depth -= 1
        if self.depth == 0 and self.collects:
            gc.enable()


Flags.__hash__ = hash_flags
Flags.__eq__ = same_flags
BaseFunction.get_call_type = find_type
Inst._rec_list_vars = list_variables
for pair in [pair for pair in ffi.lib._lock._cblist if announces_lock(pair)]:
    ffi.unregister_lock_callback(*pair)
event.register("numba:compile", _Collector())
