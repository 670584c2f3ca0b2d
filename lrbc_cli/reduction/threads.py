"""Threads for work on small dense matrices: the lines of one evaluation are shared, or independent tasks run at the same time."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar, copy_context
from functools import cache
from itertools import pairwise
from threading import Thread
from typing import Any, TypeVar

import numpy as np
from threadpoolctl import ThreadpoolController

T = TypeVar("T")
R = TypeVar("R")

#: Two threads are used if lines x states x terms³ is at least THREADED (smaller work is done before a thread has started), n threads if it
#: is n/2 times as much. Up to MOST_TERMS terms LAPACK does not use threads of its own.
THREADED, MOST_TERMS = 2e6, 128

#: Bytes of the matrices that are solved in one batch, so that they stay in the cache of a core.
CACHED = 2_000_000

#: Most threads of one piece of work: beyond, they wait for the interpreter.
MOST_THREADS = 8

#: Number of threads that this work may use: the share of the cores that other work leaves it, one inside parallel threads.
_share: ContextVar[int] = ContextVar("share", default=MOST_THREADS)


def cores() -> int:
    """Number of cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def threads() -> int:
    """Number of threads that this work may use."""
    return min(cores(), _share.get())


def side_by_side(work: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """Results of ``work`` for independent items, as many at a time as this work may use threads.

    Parameters
    ----------
    work : callable
        Must not change anything that it reads for another item.
    items : iterable

    Returns
    -------
    list
        In the order of the items, independent of the threads.
    """
    todo = list(items)
    if len(todo) < 2 or threads() < 2:
        return [work(item) for item in todo]

    settings = np.geterr()

    def one(item: T) -> R:
        with _floating_point(settings):
            return work(item)

    pool = ThreadPoolExecutor(min(threads(), len(todo)))
    try:
        with single_threaded(), in_turn():
            # Each task has the context of the caller; before NumPy 2 the floating-point error settings belonged to a thread.
            return [future.result() for future in [pool.submit(copy_context().run, one, item) for item in todo]]
    finally:
        pool.shutdown(cancel_futures=True)


def _floating_point(settings: Any) -> AbstractContextManager[None]:
    """Context with the floating-point error settings of the caller, in another thread.

    Not entered where that thread has them: NumPy 1 counts the threads with other settings than the default, and one that sets the default
    anew is subtracted, so that errors which another thread ignores are reported there.
    """
    return nullcontext() if settings == np.geterr() else np.errstate(**settings)


@contextmanager
def at_most(count: int) -> Iterator[None]:
    """Context in which work uses no more than ``count`` threads, for instance beside other work."""
    token = _share.set(max(1, min(count, _share.get())))
    try:
        yield
    finally:
        _share.reset(token)


def sharing(workers: int) -> ThreadPoolExecutor:
    """Pool of ``workers`` threads that share the cores: what runs in one of them uses that share."""
    return ThreadPoolExecutor(workers, initializer=_share.set, initargs=(max(1, threads() // workers),))


def in_turn() -> AbstractContextManager[None]:
    """Context without parallel threads, for work that has threads of its own or needs much memory."""
    return at_most(1)


def by_lines(lines: int, terms: int, states: int, work: Callable[[slice], None]) -> None:
    """Run ``work`` on slices of lines small enough for the cache of a core, in several threads if that is faster.

    Parameters
    ----------
    lines, terms, states : int
        Size of the work: a matrix of shape (terms, terms) for each line and state.
    work : callable
        Its result for a line must not depend on the slice.

    Raises
    ------
    Exception
        Any exception of ``work``, after all threads have ended.
    """
    most = int(min(threads(), 2.0 * lines * states * float(terms) ** 3 // THREADED)) if THREADED else threads()
    count = max(-(-lines * states * terms**2 * np.dtype(complex).itemsize // CACHED), most, 1)
    ends = np.linspace(0, lines, min(count, lines) + 1).round().astype(int).tolist()
    slices = [slice(first, last) for first, last in pairwise(ends)]

    def some(parts: list[slice]) -> None:
        for part in parts:
            work(part)

    most = min(most, len(slices))
    if most < 2:
        some(slices)
        return
    settings, failed = np.geterr(), list[BaseException]()

    def beside(first: int) -> None:
        try:
            with _floating_point(settings):
                some(slices[first::most])
        except Exception as error:
            failed.append(error)

    with single_threaded() if terms > MOST_TERMS else nullcontext():
        helpers = [Thread(target=beside, args=(first,), daemon=True) for first in range(1, most)]
        for helper in helpers:
            helper.start()
        try:
            some(slices[::most])
        finally:
            for helper in helpers:
                helper.join()
    if failed:
        raise failed[0]


@cache
def _blas() -> ThreadpoolController:
    """The BLAS libraries of NumPy and SciPy; cached, since finding them takes longer than a small chunk of work."""
    return ThreadpoolController().select(user_api="blas")


def single_threaded() -> AbstractContextManager[object]:
    """Context with one BLAS thread, for small matrices, where more threads cost more than they gain."""
    limit: AbstractContextManager[object] = _blas().limit(limits=1)
    return limit


def in_chunks(count: int, work: Callable[[slice], None], *, chunk: int = 16, workers: int = 2) -> None:
    """Run ``work`` on slices of ``chunk`` lines in ``workers`` threads with one BLAS thread each (small dense solves release the GIL)."""
    slices = [slice(at, min(at + chunk, count)) for at in range(0, count, chunk)]
    if threads() < 2:
        for part in slices:
            work(part)
        return
    with single_threaded():
        if len(slices) < 2 or workers < 2:
            for part in slices:
                work(part)
            return
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(work, slices))
