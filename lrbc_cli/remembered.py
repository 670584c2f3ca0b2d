"""A small cache in memory: `lrbc watch`, for example, reads results and writes its page again for each new job."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from threading import Lock
from typing import Generic, TypeVar

T = TypeVar("T")


class Remembered(Generic[T]):
    """Values that are cached by a digest of the content they were computed from; the oldest is dropped first. Safe for threads.

    Parameters
    ----------
    most : int
        Number of values kept.
    """

    def __init__(self, most: int) -> None:
        self._most, self._known, self._lock = most, dict[tuple[object, bytes], T](), Lock()

    def of(self, content: bytes, make: Callable[[], T], kind: object = None) -> T:
        """The cached value of a content, computed by ``make`` if it is missing; exceptions of ``make`` pass through and are not cached.

        Parameters
        ----------
        content : bytes
        make : callable
            Returns the value, which is shared and must not be changed.
        kind : hashable
            Tells apart different values that are computed from the same content.
        """
        key = (kind, hashlib.sha256(content).digest())
        with self._lock:
            if key in self._known:
                return self._known[key]
        value = make()
        with self._lock:
            while len(self._known) >= self._most:
                del self._known[next(iter(self._known))]
            return self._known.setdefault(key, value)
