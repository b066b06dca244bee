"""Machine code that does the same in every process, whatever was compiled or loaded there before.

Numba leaves two things to chance. Both are mended here for the functions of this package and of planners written for
it (:func:`pcs_racing.compilation.compiled`).

*Which copy of a function runs.* A compiled function brings copies of those that it calls, each optimised again in its
new place. The copies are weak symbols: where two loaded libraries have the same one, all callers are bound to the one
that was loaded first. For arithmetic that the compiler may rearrange (``fastmath``) two copies may differ in the last
bit, so that races depended on what a process had compiled or loaded before. Here a library calls its own copies.

*The index of the cache on disk.* Numba reads it, adds a line and writes it back. Two processes that do so at the same
time may end with a line of one that points to the code of the other. Here they take turns.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import Any

from llvmlite import binding
from numba.core import caching, codegen
from numba.core.itanium_mangler import mangle_identifier

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

__all__ = ["keep_own_copies"]

_names: set[str] = set()  # how the symbols of our functions begin


def keep_own_copies(function: Callable[..., Any]) -> None:
    """Let every library that contains a copy of this function keep it to itself."""
    _names.add("_Z" + mangle_identifier(f"{function.__module__}.{function.__qualname__}").removesuffix("E"))


def _with_own_copies(finalize: Callable[[Any], None]) -> Callable[[Any], None]:
    """Turn copies of our functions into local symbols, after the optimiser and before machine code is made."""

    @wraps(finalize)
    def finalize_with_own_copies(library: Any) -> None:
        copies = [
            function
            for function in _defined(library._final_module, binding.Linkage.linkonce_odr)
            if function.name.startswith(tuple(_names))
        ]
        if copies and library._shared_module is None:
            library._shared_module = _to_be_linked(library._final_module)
            for function in copies:
                function.linkage = binding.Linkage.internal
        finalize(library)

    return finalize_with_own_copies


def _to_be_linked(module: Any) -> Any:
    """What other libraries take their copies from, made as numba makes it: there symbols may come twice."""
    shared = module.clone()
    for function in _defined(shared, binding.Linkage.external):
        function.linkage = binding.Linkage.linkonce_odr
    return shared


def _defined(module: Any, linkage: Any) -> list[Any]:
    return [function for function in module.functions if not function.is_declaration and function.linkage is linkage]


def _one_at_a_time(save: Callable[..., None]) -> Callable[..., None]:
    """Let those who add to a folder of cached code take turns, whatever process they are in."""

    @wraps(save)
    def save_alone(cache: Any, key: Any, data: Any) -> None:
        with _turn(Path(cache._cache_path) / ".lock"):
            save(cache, key, data)

    return save_alone


@contextmanager
def _turn(path: Path) -> Iterator[None]:
    if fcntl is None:
        yield
        return
    with open(path, "ab") as lock:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield  # closing the file ends the turn


codegen.CPUCodeLibrary._finalize_final_module = _with_own_copies(codegen.CPUCodeLibrary._finalize_final_module)
caching.IndexDataCacheFile.save = _one_at_a_time(caching.IndexDataCacheFile.save)
