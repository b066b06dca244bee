"""Compilation with numba: decorators for compiled functions, and a message when compilation takes a while."""

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

    Division by zero gives infinity, as in numpy; a check for it would prevent vector instructions. Leave ``fastmath``
    off, and use the elementary functions of :mod:`pcs_racing.base.elementary`. Then a function computes the same bits
    on every processor, and in every copy that the compiler inlines into its callers.

    Parameters
    ----------
    function : callable, optional
        The function to compile; without it, a decorator is returned.
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
    """Compile a function like :func:`compiled`, but without reference counts for its arrays.

    Only for functions that neither allocate nor return arrays (allocating in one is an error when it is compiled).
    Numba offers no public option for that. Without this one (``_nrt=False``) a scan of 108 beams takes 21 us instead of
    4 us, a race 7 % longer, and two threads count the same shared arrays (benchmarks/scan_speed.py, race_speed.py).

    Parameters
    ----------
    function : callable, optional
        The function to compile; without it, a decorator is returned.
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
        Name of the compiled code in the message.
    seconds : int
        Approximate time that the compilation takes, s.
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
