"""Two threads for work on small dense matrices: the lines of one evaluation are shared, or independent tasks run at the same time."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar, copy_context
from functools import cache
from itertools import pairwise
from threading import Thread
from typing import TypeVar

import numpy as np
from threadpoolctl import ThreadpoolController

T = TypeVar("T")
R = TypeVar("R")

#: Two threads are used if lines x states x terms³ is at least THREADED (smaller work is done before a thread has started). Up to MOST_TERMS
#: terms LAPACK does not use threads of its own.
THREADED, MOST_TERMS = 2e6, 128

#: Bytes of the matrices that are solved in one batch, so that they stay in the cache of a core.
CACHED = 2_000_000

#: Whether this work runs in one of two parallel threads already, and must not start further ones.
_beside: ContextVar[bool] = ContextVar("beside", default=False)


def cores() -> int:
    """Number of cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def side_by_side(work: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """Results of ``work`` for independent items, two items at a time.

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
    if len(todo) < 2 or cores() < 2 or _beside.get():
        return [work(item) for item in todo]

    settings = np.geterr()

    def one(item: T) -> R:
        with np.errstate(**settings):
            return work(item)

    pool = ThreadPoolExecutor(2)
    try:
        with single_threaded(), in_turn():
            # Each task has the context of the caller; before NumPy 2 the floating-point error settings belonged to a thread.
            return [future.result() for future in [pool.submit(copy_context().run, one, item) for item in todo]]
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def in_turn() -> Iterator[None]:
    """Context without parallel threads, for work that has threads of its own or needs much memory."""
    token = _beside.set(True)
    try:
        yield
    finally:
        _beside.reset(token)


def by_lines(lines: int, terms: int, states: int, work: Callable[[slice], None]) -> None:
    """Run ``work`` on slices of lines small enough for the cache of a core, in two threads if that is faster.

    Parameters
    ----------
    lines, terms, states : int
        Size of the work: a matrix of shape (terms, terms) for each line and state.
    work : callable
        Its result for a line must not depend on the slice.

    Raises
    ------
    Exception
        Any exception of ``work``, after both threads have ended.
    """
    shared = lines * states * float(terms) ** 3 >= THREADED and cores() > 1 and not _beside.get()
    count = max(-(-lines * states * terms**2 * np.dtype(complex).itemsize // CACHED), 2 if shared else 1)
    ends = np.linspace(0, lines, min(count, lines) + 1).round().astype(int).tolist()
    slices = [slice(first, last) for first, last in pairwise(ends)]

    def some(parts: list[slice]) -> None:
        for part in parts:
            work(part)

    if not shared or len(slices) < 2:
        some(slices)
        return
    settings, failed = np.geterr(), list[BaseException]()

    def first() -> None:
        try:
            with np.errstate(**settings):
                some(slices[::2])
        except Exception as error:
            failed.append(error)

    with single_threaded() if terms > MOST_TERMS else nullcontext():
        helper = Thread(target=first, daemon=True)
        helper.start()
        try:
            some(slices[1::2])
        finally:
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
    if _beside.get():
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
