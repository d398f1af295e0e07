"""What the browser asks for, until the one thread that solves has time for it."""

import threading
from collections.abc import Hashable

from ...edit.ik.session import Verb


class Inbox:
    """Verbs in their order; of the moves of one drag only the newest is kept, so that a solver that is slower than the
    hand is never behind it."""

    def __init__(self):
        self._waiting: list[tuple[Hashable, Verb]] = []
        self._something = threading.Condition()

    def put(self, verb: Verb, kind: Hashable = None) -> None:
        """Add a verb; in place of the last one where both are of the same kind, unless that is None."""
        with self._something:
            if kind is not None and self._waiting and self._waiting[-1][0] == kind:
                self._waiting.pop()
            self._waiting.append((kind, verb))
            self._something.notify_all()

    def take(self, seconds: float) -> list[Verb]:
        """All there are, or none if none comes for so long."""
        with self._something:
            if not self._waiting:
                self._something.wait(seconds)
            verbs = [verb for _, verb in self._waiting]
            self._waiting.clear()
            return verbs
