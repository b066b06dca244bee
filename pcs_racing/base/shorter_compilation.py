"""Shorter compilation: what numba works out again and again while it compiles, worked out once.

Most of the processor time that numba takes to compile the kernels of a race is spent in its own Python code, not in
LLVM, and much of that in a few things that have no say in the machine code, and for which numba has no setting.
:class:`ShorterCompilation` replaces them while kernels of these packages are compiled, and puts numba's own back
afterwards:

* Numba looks up its own helper functions by the types of their arguments and by the options (`Flags`) of the caller.
  All options have the same hash, and two of them are compared by two dictionaries of all their values.
* An addition, a comparison or an index is given its type anew wherever it stands in a kernel: all ways in which numba
  knows to add (numbers, strings, lists, arrays, ...) are tried until one fits the types.
* The variables of each statement are listed again after every pass, which calls a method for each part of it.
* Python's collector of cyclic garbage looks through objects that all stay in use.

Where a version of numba has not got one of these methods, nothing is replaced. ``benchmarks/start_time.py`` measures
the time of compilation.
"""

import gc
from typing import Any

from numba.core import compiler, event, ir, types

_find_type = types.BaseFunction.get_call_type

_types_found: dict[tuple[Any, ...], tuple[Any, Any]] = {}
"""Of a function (by its id, as its hash is slow), a context and argument types: the function, and the signature."""


def same_options(options: Any, other: object) -> Any:
    """Whether all options are equal; one that is not set has its default value."""
    if not isinstance(other, compiler.Flags):
        return NotImplemented
    own, others = options._values, other._values
    if own == others:
        return True
    return all(getattr(options, name) == getattr(other, name) for name in own.keys() | others.keys())


def hash_of_options(_options: Any) -> int:
    """The hash that numba gives to all options: that of their names."""
    return _HASH


_HASH = hash(compiler.Flags())


def find_type(function: Any, context: Any, arguments: Any, named: Any) -> Any:
    """Signature of a call of one of numba's own functions, kept where nothing had to be compiled to find it.

    What numba has to compile for a call depends on the options of the caller, too.
    """
    if named:
        return _find_type(function, context, arguments, named)
    key = id(function), id(context), tuple(arguments)
    if key in _types_found:
        return _types_found[key][1]
    signature = _find_type(function, context, arguments, named)
    if signature is not None and function.get_impl_key(signature) is function.typing_key:
        _types_found[key] = function, signature  # as long as it is kept here, its id is not given to another
    return signature


def list_variables(statement: ir.Inst, part: Any) -> list[ir.Var]:
    """Variables in a part of a statement: in an instruction, or in a list, tuple or dictionary of parts."""
    if isinstance(part, ir.Inst):
        return part.list_vars()
    if isinstance(part, dict):
        part = part.values()
    elif not isinstance(part, list | tuple):
        return [part] if isinstance(part, ir.Var) else []
    found = []
    for each in part:
        if type(each) is ir.Var:
            found.append(each)
        elif isinstance(each, ir.Inst | list | tuple | dict):
            found += list_variables(statement, each)
    return found


_REPLACED = (
    (compiler.Flags, "__eq__", same_options),
    (compiler.Flags, "__hash__", hash_of_options),
    (types.BaseFunction, "get_call_type", find_type),
    (ir.Inst, "_rec_list_vars", list_variables),
)


class ShorterCompilation(event.Listener):
    """Replaces some methods of numba while it compiles a function of these packages, with all that it calls.

    Numba compiles in one thread at a time.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.collects = True
        self.replaced: list[tuple[type, str, Any]] = []

    def on_start(self, event: event.Event) -> None:
        """Called by numba when it begins to compile a function."""
        if not _is_own(event):
            return
        self.depth += 1
        if self.depth > 1:
            return
        self.collects = gc.isenabled()
        gc.disable()
        if all(hasattr(owner, name) for owner, name, _ in _REPLACED) and hasattr(compiler.Flags(), "_values"):
            for owner, name, shorter in _REPLACED:
                self.replaced.append((owner, name, owner.__dict__.get(name)))
                setattr(owner, name, shorter)

    def on_end(self, event: event.Event) -> None:
        """Called by numba when it is done with a function, or could not compile it."""
        if not _is_own(event):
            return
        self.depth -= 1
        if self.depth > 0:
            return
        for owner, name, own in self.replaced:
            if own is None:  # inherited
                delattr(owner, name)
            else:
                setattr(owner, name, own)
        self.replaced.clear()
        _types_found.clear()  # what is registered before the next compilation must be found then
        if self.collects:
            gc.enable()


def _is_own(event: event.Event) -> bool:
    module = event.data["dispatcher"].py_func.__module__
    return str(module).partition(".")[0] in ("pcs_racing", "pcs_racing_agents")


event.register("numba:compile", ShorterCompilation())
