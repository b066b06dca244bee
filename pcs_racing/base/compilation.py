"""Compilation with numba: decorators for compiled functions, and a message when compilation takes a
while.
"""

import gc
import time
import timeit
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from numba import njit

from pcs_racing.base.code_cache import code_folder
from pcs_racing.base.errors import say, say_once
from pcs_racing.base.numba_parts import CodeCache, config, inner, linked


def compiled(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function with numba: cached on disk if it has a file, without the GIL, with IEEE
    division.

    Division by zero gives infinity, as in numpy; a check for it would prevent vector instructions.
    Leave ``fastmath`` off, and use the elementary functions of :mod:`pcs_racing.base.elementary`.
    Then a function computes the same bits on every processor, and in every copy inlined into its
    callers.

    Without a function, return a decorator. All other options go to :func:`numba.njit`.
    """
    # Explicit even for the default: otherwise a function compiled for a kernel would inherit the
    # kernel's choice.
    options.setdefault("_nrt", True)

    def decorate(function: Callable[..., Any]) -> Any:
        # These functions are not called from C: C wrappers would take a tenth of the compilation.
        options.setdefault("no_cfunc_wrapper", True)
        dispatcher = njit(nogil=True, error_model="numpy", **options)(function)
        file = Path(function.__code__.co_filename)
        if config.DISABLE_JIT:
            return dispatcher
        if file.is_file():
            _keep_on_disk(dispatcher, file.parent)
        return linked(dispatcher)

    return decorate if function is None else decorate(function)


def _keep_on_disk(dispatcher: Any, sources: Path) -> None:
    """Cache the code of a function as ``cache=True`` does, with our cache and in our folder."""
    folder, chosen = code_folder(sources), config.CACHE_DIR
    if folder is None:
        say_once(
            "compiled code can't be kept: no folder for it can be written; NUMBA_CACHE_DIR names"
            " one"
        )
        return
    config.CACHE_DIR = str(folder)
    try:
        dispatcher._cache = CodeCache(dispatcher.py_func)
    finally:
        config.CACHE_DIR = chosen


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function like :func:`compiled`, but without reference counts for its arrays.

    Only for functions that neither allocate nor return arrays (an allocation is an error at
    compilation). Numba has no public option for this. Without the private option ``_nrt=False`` a
    scan of 108 beams takes 21 us or more instead of 4 us, and two threads count the references of
    the same arrays (dev/benchmarks/scan_speed.py).
    """
    return compiled(function, _nrt=False, **options)


def identified(function: Callable[..., Any], content: bytes) -> Any:
    """Give a function that was compiled with constants the SHA-256 of the constants.

    Fingerprints read it as ``content_hash``; without it, they take functions as equal.
    """
    function.content_hash = sha256(content).hexdigest()  # type: ignore[attr-defined]
    return function


def inner_kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function like :func:`kernel`, for calls from compiled functions only.

    The wrapper for calls from Python is left out: it takes half the compilation time of a small
    function. A call from Python raises a TypeError.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        return inner(kernel(function, no_cpython_wrapper=True, **options))

    return decorate if function is None else decorate(function)


LONG = 5.0  # s: a shorter compilation is announced only

_begun: set[str] = set()
"""Names of the functions that this process has compiled, loaded or waited for."""


def first_call(dispatcher: Any, what: str, effort: float) -> AbstractContextManager[bool]:
    """Surround the first call of a compiled function: one process compiles it, and the others wait.

    Print a line to stderr if the function is neither in memory nor in numba's cache on disk:
    ``what`` is compiled, in about ``effort`` times the duration of `_compile_sample`, or another
    process compiles it. A second line gives the duration if it was over 5 s.

    Yield True if the function is about to be compiled. A caller with long work can then call it
    without any work, so that other processes wait for the compilation alone.
    """
    if what in _begun:  # a query of numba costs more than a short race
        return _LATER_CALL
    return _first_call(dispatcher, what, effort)


# One object for all later calls: a one-step race should not make an object each time.
_LATER_CALL = nullcontext(False)


@contextmanager
def _first_call(dispatcher: Any, what: str, effort: float) -> Iterator[bool]:
    _begun.add(what)
    # Without compilation (NUMBA_DISABLE_JIT) the dispatcher is an ordinary function.
    if not hasattr(dispatcher, "signatures") or dispatcher.signatures or _on_disk(dispatcher):
        yield False
        return
    with ExitStack() as turn:
        kept = dispatcher.stats.cache_path is not None
        with suppress(OSError):  # without a writable folder every process compiles
            if kept:
                _wait_for_turn(turn, dispatcher, what)
        turn.enter_context(_without_collecting_garbage())
        # Check again: another process may have compiled the function during the wait.
        if not _on_disk(dispatcher):
            say(
                f"compiling {what} (about {effort * _compile_sample():.0f} s,"
                f" {'once; it is cached on disk' if kept else 'in each process'})"
            )
        begin = time.perf_counter()
        yield True
        if (took := time.perf_counter() - begin) > LONG:
            say(f"compiled {what} in {took:.0f} s")


@cache
def _compile_sample() -> float:
    """Return how long a small function took to compile on this machine, as busy as it is, in s."""

    def sample(x, y):  # type: ignore[no-untyped-def]
        for _ in range(3):
            x = x * y + x if x > y else y
        return x

    # The min: the first compilation takes longer, and so does one that another process interrupts.
    return min(timeit.repeat(lambda: njit("f8(f8, f8)")(sample), number=1, repeat=4))


@contextmanager
def _without_collecting_garbage() -> Iterator[None]:
    """Disable garbage collection: scanning numba's live objects takes a tenth of a compilation.

    They are millions, and all stay in use.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def _wait_for_turn(turn: ExitStack, dispatcher: Any, what: str) -> None:
    from filelock import FileLock, Timeout  # needed only for compilation

    cache = Path(dispatcher.stats.cache_path)
    cache.mkdir(parents=True, exist_ok=True)
    lock = FileLock(cache / f".{_cached_name(dispatcher)}lock")
    try:
        turn.enter_context(lock.acquire(timeout=0))
    except Timeout:
        say(f"waiting for another process that compiles {what}")
        turn.enter_context(lock.acquire())


def _on_disk(dispatcher: Any) -> bool:
    if dispatcher.stats.cache_path is None:
        return False
    cache, name = Path(dispatcher.stats.cache_path), _cached_name(dispatcher)
    return cache.is_dir() and any(entry.name.startswith(name) for entry in cache.glob("*.nbi"))


def _cached_name(dispatcher: Any) -> str:
    """Return the prefix of the names of a function's cached files."""
    return (
        f"{Path(dispatcher.py_func.__code__.co_filename).stem}.{dispatcher.py_func.__qualname__}-"
    )
