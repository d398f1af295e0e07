"""A place for one item between two threads."""

import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class Mailbox(Generic[T]):
    """A place for one item between the thread that puts it and the thread that takes it."""

    def __init__(self) -> None:
        self._item: list[T] = []
        self._changed = threading.Condition()
        self._closed = False

    def replace(self, item: T) -> T | None:
        """Put an item, also in the place of one that nobody took; return the latter."""
        with self._changed:
            old = self._item.pop() if self._item else None
            if self._closed:
                return item
            self._item.append(item)
            self._changed.notify_all()
            return old

    def put(self, item: T) -> bool:
        """Put an item when the place is free; false if the mailbox was closed before."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or not self._item)
            if self._closed:
                return False
            self._item.append(item)
            self._changed.notify_all()
            return True

    def take(self) -> T | None:
        """Wait for an item and take it; None after the mailbox was closed and emptied."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._item)
            if not self._item:
                return None
            item = self._item.pop()
            self._changed.notify_all()
            return item

    def close(self) -> None:
        """Refuse further items, and wake all threads that wait."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
