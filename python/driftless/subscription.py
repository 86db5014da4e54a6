"""What robots publish, as an iterator that keeps the newest."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class Subscription(Generic[T]):
    """Messages in the order of their arrival. At most `capacity` wait; the oldest are dropped, and counted.

    Iterating waits for messages until the subscription is closed. Use it as a context manager, or call `close`.
    """

    def __init__(self, declare: Callable[[Callable[[T], None]], Any], capacity: int = 1000):
        self.dropped: int = 0
        """Messages that nobody took in time."""
        self.unreadable: int = 0
        """Messages that could not be decoded."""
        self.last_error: Exception | None = None
        """Why the last of them could not."""
        self._capacity = capacity
        self._waiting: deque[T] = deque()
        self._changed = threading.Condition()
        self._closed = False
        self._declared = declare(self._receive)

    def _receive(self, message: T | Exception) -> None:
        with self._changed:
            if isinstance(message, Exception):
                self.unreadable += 1
                self.last_error = message
                return
            if len(self._waiting) >= self._capacity:
                self._waiting.popleft()
                self.dropped += 1
            self._waiting.append(message)
            self._changed.notify_all()

    def next(self, timeout_s: float | None = None) -> T | None:
        """The oldest message that waits, or the next to come; `None` after the timeout, or once closed and empty."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closed, timeout_s)
            return self._waiting.popleft() if self._waiting else None

    def latest(self, timeout_s: float | None = None) -> T | None:
        """The newest message, without those before it."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closed, timeout_s)
            message = self._waiting.pop() if self._waiting else None
            self._waiting.clear()
            return message

    def close(self) -> None:
        """Ends the subscription. What waits can still be taken."""
        with self._changed:
            if self._closed:
                return
            self._closed = True
            self._changed.notify_all()
        self._declared.undeclare()

    def __iter__(self) -> Iterator[T]:
        while (message := self.next()) is not None:
            yield message

    def __enter__(self) -> Subscription[T]:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
