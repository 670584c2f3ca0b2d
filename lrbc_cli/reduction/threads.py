"""Work on small dense matrices in two threads: lines shared by both, or whole pieces of work side by side."""

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

#: Cubes of the terms, summed over the lines, from which two threads solve: less is done before a thread has begun; and terms up to which
#: LAPACK does not use threads of its own.
THREADED, MOST_TERMS = 2e6, 128

#: Bytes of the matrices that are solved in one go: what a core's cache holds is not fetched from memory for each step again.
CACHED = 2_000_000

#: Whether other work goes on beside this, which then has one thread.
_beside: ContextVar[bool] = ContextVar("beside", default=False)


def side_by_side(work: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """What independent pieces of work give, two at a time.

    Parameters
    ----------
    work : callable
        Changes nothing that another piece reads.
    items : iterable

    Returns
    -------
    list
        In the order of the items, the same whatever the threads.
    """
    todo = list(items)
    if len(todo) < 2 or (os.cpu_count() or 1) < 2 or _beside.get():
        return [work(item) for item in todo]

    settings = np.geterr()

    def one(item: T) -> R:
        with np.errstate(**settings):
            return work(item)

    pool = ThreadPoolExecutor(2)
    try:
        with single_threaded(), in_turn():
            # Settings are those of the caller; before NumPy 2 errors of floats were settings of a thread.
            return [future.result() for future in [pool.submit(copy_context().run, one, item) for item in todo]]
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def in_turn() -> Iterator[None]:
    """Nothing is done side by side, for work that has threads of its own or needs much memory."""
    token = _beside.set(True)
    try:
        yield
    finally:
        _beside.reset(token)


def by_lines(lines: int, terms: int, states: int, work: Callable[[slice], None]) -> None:
    """Run ``work`` on slices of lines whose matrices a core's cache holds, in two threads where that pays.

    Parameters
    ----------
    lines, terms, states : int
        Matrices of ``(terms, terms)`` for each line and state.
    work : callable
        What it does for a line is the same whatever the slice.

    Raises
    ------
    Exception
        Whatever ``work`` raises, once both threads have ended.
    """
    shared = lines * states * float(terms) ** 3 >= THREADED and (os.cpu_count() or 1) > 1 and not _beside.get()
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
    """The BLAS libraries of NumPy and SciPy; looking for them takes longer than a small chunk."""
    return ThreadpoolController().select(user_api="blas")


def single_threaded() -> AbstractContextManager[object]:
    """BLAS with one thread, for work on small matrices: its threads would cost more than they do."""
    limit: AbstractContextManager[object] = _blas().limit(limits=1)
    return limit


def in_chunks(count: int, work: Callable[[slice], None], *, chunk: int = 16, workers: int = 2) -> None:
    """Run ``work`` on slices of lines, in threads with BLAS limited to one thread each (small dense solves release the GIL)."""
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
