"""The queue of requests from the browser to the solver thread."""

import threading
from collections.abc import Hashable

from ...edit.ik.session import Verb


class Inbox:
    """A queue of edits in order. Of the moves of one drag only the newest is kept, so that a solver slower
    than the hand does not lag behind."""

    def __init__(self):
        self._waiting: list[tuple[Hashable, Verb]] = []
        self._something = threading.Condition()

    def put(self, verb: Verb, kind: Hashable = None) -> None:
        """Append an edit, or replace the last one if both have the same `kind` that is not None."""
        with self._something:
            if kind is not None and self._waiting and self._waiting[-1][0] == kind:
                self._waiting.pop()
            self._waiting.append((kind, verb))
            self._something.notify_all()

    def take(self, seconds: float) -> list[Verb]:
        """Take all waiting edits; wait up to `seconds` for the first."""
        with self._something:
            if not self._waiting:
                self._something.wait(seconds)
            verbs = [verb for _, verb in self._waiting]
            self._waiting.clear()
            return verbs
