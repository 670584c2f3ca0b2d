"""Work on small dense matrices in two threads: lines shared by both, or whole pieces of work side by side."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar, copy_context
from functools import cache
from threading import Thread
from typing import TypeVar

import numpy as np
from threadpoolctl import ThreadpoolController

from lrbc_cli.arrays import Complexes

T = TypeVar("T")
R = TypeVar("R")

#: Cubes of the terms, summed over the lines, from which two threads solve: less is done before a thread has begun; and terms up to which
#: LAPACK does not use threads of its own.
THREADED, MOST_TERMS = 2e6, 128

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


def solved(A: Complexes, B: Complexes) -> Complexes:
    """``A⁻¹ B`` line by line, the lines shared by two threads where that pays.

    Parameters
    ----------
    A : (..., F, n, n) complex array
    B : (F, n, k) complex array

    Returns
    -------
    (..., F, n, k) complex array
        The same whatever the threads.

    Raises
    ------
    numpy.linalg.LinAlgError
        Where a line is singular.
    """
    if A.ndim > 3:
        each = np.broadcast_to(B, (*A.shape[:-1], B.shape[-1]))
        states = math.prod(A.shape[:-2])
        return solved(A.reshape(states, *A.shape[-2:]), each.reshape(states, *B.shape[-2:])).reshape(each.shape)
    lines, n = A.shape[:2]
    if lines * float(n) ** 3 < THREADED or n > MOST_TERMS or (os.cpu_count() or 1) < 2 or _beside.get():
        return np.asarray(np.linalg.solve(A, B))
    found = np.empty(B.shape, dtype=np.result_type(A, B))
    middle = lines // 2
    failed: list[BaseException] = []

    def first() -> None:
        try:
            found[:middle] = np.linalg.solve(A[:middle], B[:middle])
        except Exception as error:
            failed.append(error)

    helper = Thread(target=first, daemon=True)
    helper.start()
    try:
        found[middle:] = np.linalg.solve(A[middle:], B[middle:])
    finally:
        helper.join()
    if failed:
        raise failed[0]
    return found


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
