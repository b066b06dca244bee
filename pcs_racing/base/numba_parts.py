"""All uses of numba's private parts, each with the feature that needs it.

- `CodeCache`: numba fails in every later run on a file that a full disk left unreadable, and two
  processes that compile a function at the same time may swap their code.
- `linked`: numba optimises each function, and makes machine code of it, together with all
  functions that it calls, which takes two thirds of the time of a compilation.
- `inner`: without a wrapper for calls from Python, code compiles faster; such a call would crash.
- `compiled_for`, `address_of`, `call_with`: calls without a lookup of types, which takes longer
  than a step of a race. Numba's function types would also compile the race for each planner.
"""

from contextlib import ExitStack, suppress
from functools import cached_property
from pathlib import Path
from typing import Any

import numba
from numba import typeof, types
from numba.core import cgutils, errors
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher
from numba.extending import intrinsic

from pcs_racing.base.errors import say_once

config: Any = numba.config  # without declared names


class CodeCache(FunctionCache):
    """Numba's cache of one function's compiled code."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the code for a signature, or None without readable code."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # damaged pickles raise many types of errors
            say_once("cached code can't be read; it is compiled again")
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save the code for a signature; one process at a time writes to a folder."""
        from filelock import FileLock  # needed only for compilation

        with ExitStack() as turn:
            with suppress(OSError):  # a file system without locks
                turn.enter_context(FileLock(Path(self.cache_path) / ".lock"))
            try:
                super().save_overload(sig, data)
            except OSError as error:
                say_once(f"compiled code can't be kept in {self.cache_path}: {error.strerror}")


class _LinkedLibrary(JITCodeLibrary):
    """Code that is optimised, and made into machine code, only as a part of its callers."""

    @property
    def codegen(self) -> Any:
        """Recipient of `set_env`."""
        return self

    def set_env(self, name: str, env: Any) -> None:
        """Do nothing: the environment serves Python objects, which have no place in kernels."""

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0 for no machine code."""
        self._ensure_finalized()
        return 0

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _LinkedCompiler(Compiler):
    def __init__(self, typing: Any, target: Any, library: Any, *others: Any) -> None:
        library = library or _LinkedLibrary(target.codegen(), "linked")
        super().__init__(typing, target, library, *others)


class _Linked(CPUDispatcher):
    @cached_property
    def _part(self) -> Any:
        """Function in the form for its compiled callers."""
        options = {**self.targetoptions, "no_cpython_wrapper": True}
        return CPUDispatcher(self.py_func, self.locals, options, pipeline_class=_LinkedCompiler)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return self._part.get_call_template(args, kws)

    def get_overload(self, sig: Any) -> Any:
        return self._part.get_overload(sig)


def linked(dispatcher: Any) -> Any:
    """Compile a function for its compiled callers as a part of them, without machine code."""
    dispatcher.__class__ = _Linked
    return dispatcher


class _Inner(_Linked):
    def __call__(self, *arguments: Any, **named: Any) -> Any:
        raise TypeError(
            f"{self.py_func.__qualname__} is an inner kernel: only compiled functions can call it"
        )


def inner(dispatcher: Any) -> Any:
    """Refuse calls of a compiled function from Python."""
    if isinstance(dispatcher, CPUDispatcher):  # without compilation: the function itself
        dispatcher.__class__ = _Inner
    return dispatcher


def compiled_for(function: Any, arguments: tuple[Any, ...]) -> Any:
    """Return the machine code of a compiled function for arguments of exactly these types.

    Without compilation (``NUMBA_DISABLE_JIT``), return the function itself.
    """
    if not hasattr(function, "compile"):
        return function
    return function.compile(tuple(map(typeof, arguments)))


def address_of(code: Any) -> int:
    """Return the address of compiled code, one of a function's ``overloads``."""
    return code.library.get_pointer_to_function(code.fndesc.llvm_func_name)


def address_for(function: Any, wanted: tuple[types.Type, ...]) -> Any:
    """Compile a function for types of arguments, unless it is, and return its address.

    Without compilation (``NUMBA_DISABLE_JIT``), return the function itself.
    """
    if not hasattr(function, "compile"):
        return function
    if wanted not in function.overloads:
        function.compile(wanted)
    return address_of(function.overloads[wanted])


def compiled_address(function: Any, *arguments: Any) -> Any:
    """Return the address of a compiled function for arguments of exactly these types.

    Without compilation (``NUMBA_DISABLE_JIT``), return the function itself.
    """
    if not hasattr(function, "compile"):
        return function
    return address_for(function, tuple(map(typeof, arguments)))


def call_with(wanted: tuple[types.Type, ...] | None = None) -> Any:
    """Return a compiled function that calls an address with a tuple of arguments.

    Without ``wanted`` types of arguments, the address must be of a function for the types of the
    given arguments (`address_for`).
    """

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        given = tuple(signature.args[1])
        function = context.call_conv.get_function_type(types.none, given)
        callee = builder.inttoptr(values[0], function.as_pointer())
        unpacked = cgutils.unpack_tuple(builder, values[1], len(given))
        status, _ = context.call_conv.call_function(builder, callee, types.none, given, unpacked)
        with builder.if_then(status.is_error, likely=False):  # the race raises the planner's error
            context.call_conv.return_status_propagate(builder, status)
        return context.get_dummy_value()

    @intrinsic
    def call(typing: Any, address: Any, arguments: Any) -> Any:
        if wanted is not None and tuple(arguments) != wanted:
            raise errors.TypingError(f"a planner's function takes {wanted}, not {arguments}")
        return types.none(types.intp, arguments), generate

    return (lambda function, given: function(*given)) if config.DISABLE_JIT else call
