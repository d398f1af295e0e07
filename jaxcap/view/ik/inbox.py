"""The queue of requests from the browser to the solver thread."""

import threading
from collections.abc import Hashable

from ...edit.ik.session import Edit


class Inbox:
    """A queue of edits in order. Of the moves of one drag only the newest is kept, so that a solver slower
    than the hand does not lag behind."""

    def __init__(self):
        self._queue: list[tuple[Hashable, Edit]] = []
        self._condition = threading.Condition()

    def put(self, edit: Edit, kind: Hashable = None) -> None:
        """Append an edit, or replace the last one if both have the same `kind` that is not None."""
        with self._condition:
            if kind is not None and self._queue and self._queue[-1][0] == kind:
                self._queue.pop()
            self._queue.append((kind, edit))
            self._condition.notify_all()

    def take(self, seconds: float) -> list[Edit]:
        """Take all waiting edits; wait up to `seconds` for the first."""
        with self._condition:
            if not self._queue:
                self._condition.wait(seconds)
            verbs = [verb for _, verb in self._queue]
            self._queue.clear()
            return verbs
