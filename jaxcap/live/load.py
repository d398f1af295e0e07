"""The load of a live run: whether frames are dropped so often that images are read with fewer pixels."""

from collections import deque

#: number of tracked frames that are looked at, and number of these that may follow dropped ones before images are reduced
WINDOW, MAX_STALLS = 20, 2
#: number of frames before whole images are tried again; it doubles up to the second after each attempt that fails
FIRST_PAUSE, LAST_PAUSE = 150, 4800


class Load:
    """Decides if images are reduced, from how often frames are dropped; the caller excludes simultaneous calls.

    Frames that are dropped one after the other count once: a single pause of the computer is no load.
    After each dropped frame the next motion is larger, and the body may be lost. A reduced image only makes the pose slightly
    less accurate. After a pause whole images are tried again, as other programs may have ended.
    """

    def __init__(self) -> None:
        #: whether images are reduced
        self.is_high = False
        self._pause, self._since = FIRST_PAUSE, LAST_PAUSE
        self._has_dropped = False
        #: of each of the last tracked frames, whether frames were dropped before it
        self._stalls: deque[bool] = deque(maxlen=WINDOW)

    def count(self, dropped: bool) -> None:
        """Count a frame, which was dropped or not."""
        self._since += 1
        if dropped:
            self._has_dropped = True
        else:
            self._stalls.append(self._has_dropped)
            self._has_dropped = False
        many = sum(self._stalls) > MAX_STALLS
        if many and not self.is_high:
            # an attempt with whole images has failed if it lasted less than the pause before it
            self._pause = min(2 * self._pause, LAST_PAUSE) if self._since < self._pause else FIRST_PAUSE
            self._change(True)
        elif not many and self.is_high and self._since >= self._pause:
            self._change(False)

    def _change(self, high: bool) -> None:
        self.is_high, self._since = high, 0
        self._stalls.clear()
