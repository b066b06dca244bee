"""How this package compiles its hot paths, keeps them on disk, and says so when the first time takes a while."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numba import njit

from pcs_racing.base.code_cache import forget_stale_code

__all__ = ["announce_compilation", "compiled", "inner_kernel", "kernel"]


def compiled(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function with numba: cached on disk, without the GIL, with IEEE division.

    Division by zero then gives infinity as in numpy; a check for it would keep the compiler from using vector
    instructions. Leave ``fastmath`` off, and take sines and the like from :mod:`pcs_racing.base.elementary`: then a
    function computes the same bits on every processor, and in each of the copies that its callers contain.

    Parameters
    ----------
    function : callable, optional
        What to compile; without it, a decorator is returned.
    **options
        Further options of :func:`numba.njit`.
    """
    # Stated even where it is the default: otherwise a function compiled for a kernel would inherit the kernel's choice.
    options.setdefault("_nrt", True)

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = njit(cache=True, nogil=True, error_model="numpy", **options)(function)
        source = Path(function.__code__.co_filename)
        if source not in _sources and hasattr(dispatcher, "stats"):  # without compilation it is the function itself
            _sources.add(source)
            forget_stale_code(source, Path(dispatcher.stats.cache_path))
        return dispatcher

    return decorate if function is None else decorate(function)


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function as :func:`compiled` does, but without counting references to its arrays.

    Only for functions that neither allocate nor return arrays (allocating in one is an error when it is compiled).
    Numba offers no public option for that. Without this one (``_nrt=False``) a scan of 108 beams takes 21 us instead of
    4 us, a race 7 % longer, and two threads count the same shared arrays (benchmarks/scan_speed.py, race_speed.py).

    Parameters
    ----------
    function : callable, optional
        What to compile; without it, a decorator is returned.
    **options
        Further options of :func:`numba.njit`.
    """
    return compiled(function, _nrt=False, **options)


def inner_kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function as :func:`kernel` does, for other kernels alone.

    It is left without the wrapper through which Python would call it, half the time of compiling a small one. A call
    from Python crashes the process.

    Parameters
    ----------
    function : callable, optional
        What to compile; without it, a decorator is returned.
    **options
        Further options of :func:`numba.njit`.
    """
    return kernel(function, no_cpython_wrapper=True, no_cfunc_wrapper=True, **options)


_sources: set[Path] = set()
"""Files with compiled functions whose cached code was looked at in this process."""

_announced: set[str] = set()


@contextmanager
def announce_compilation(dispatcher: Any, what: str, seconds: int) -> Iterator[None]:
    """Print a line to stderr if a compiled function is neither in memory nor in numba's cache on disk.

    Parameters
    ----------
    dispatcher : numba dispatcher
        The function about to be called.
    what : str
        What is being compiled, for the reader.
    seconds : int
        About how long it takes.
    """
    # Without compilation (NUMBA_DISABLE_JIT) it is an ordinary function.
    if what not in _announced and hasattr(dispatcher, "signatures") and not dispatcher.signatures:
        _announced.add(what)
        name = f"{Path(dispatcher.py_func.__code__.co_filename).stem}.{dispatcher.py_func.__qualname__}-"
        cache = Path(dispatcher.stats.cache_path)
        if not (cache.is_dir() and any(entry.name.startswith(name) for entry in cache.glob("*.nbi"))):
            line = f"pcs-racing: compiling {what} (about {seconds} s, once; it is cached on disk)"
            print(line, file=sys.stderr, flush=True)
    yield
