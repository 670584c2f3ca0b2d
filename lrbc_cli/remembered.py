"""What a process has worked out once: whoever watches a campaign reads its results and writes its page again for each new job."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from threading import Lock
from typing import Generic, TypeVar

T = TypeVar("T")


class Remembered(Generic[T]):
    """Values by the content that they rest on; the last ones.

    Parameters
    ----------
    most : int
        So many are kept.
    """

    def __init__(self, most: int) -> None:
        self._most, self._known, self._lock = most, dict[tuple[object, bytes], T](), Lock()

    def of(self, content: bytes, make: Callable[[], T], kind: object = None) -> T:
        """The value of a content, made where it is not known; what ``make`` raises is not kept.

        Parameters
        ----------
        content : bytes
        make : callable
            Its value is shared: nobody changes it.
        kind : hashable
            What is made of the content, where that differs.
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
