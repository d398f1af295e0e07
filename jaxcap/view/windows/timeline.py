"""Which frame is to be seen now: a clock that can be stopped, turned and run at other speeds.

The frame follows from the time alone. A window that is slow therefore leaves frames out and is never late.
"""

import math
from dataclasses import dataclass

#: how much faster or slower a motion may be played
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)


@dataclass
class Timeline:
    """`frames` frames, `rate` of them a second, from the first on again after the last.

    Times are seconds of any clock that does not go back, such as `time.monotonic`.
    """

    frames: int
    rate: float
    playing: bool = False
    speed: float = 1.0
    #: where it was, as a number of frames, when it was last touched
    _frame: float = 0.0
    _since: float = 0.0

    def frame(self, now: float) -> int:
        """The frame to show."""
        return min(int(self._at(now)), self.frames - 1)

    def play(self, now: float) -> None:
        """Go on; from the first frame where it has come to the last."""
        at = self.frame(now)
        self._touch(0 if at == self.frames - 1 else at, now)
        self.playing = True

    def pause(self, now: float) -> None:
        """Stay at the frame that is shown."""
        self._touch(self.frame(now), now)
        self.playing = False

    def seek(self, frame: int, now: float) -> None:
        """Go to a frame, the nearest there is, and go on from there where it plays."""
        self._touch(min(max(frame, 0), self.frames - 1), now)

    def step(self, frames: int, now: float) -> None:
        """Stop so many frames further on, or back where negative, at the first or last at most."""
        at = self.frame(now)
        self.playing = False
        self.seek(at + frames, now)

    def run_at(self, speed: float, now: float) -> None:
        """Play `speed` times as fast."""
        self._touch(self._at(now), now)
        self.speed = speed

    def grow(self, frames: int, now: float) -> None:
        """There are more frames now, or fewer; the one that is shown stays where it can."""
        self._touch(min(self._at(now), frames - 1), now)
        self.frames = max(frames, 1)

    def wait(self, now: float) -> float:
        """Seconds until there is another frame to show; infinite where it stands."""
        if not self.playing or self.frames < 2:
            return math.inf
        place = self._at(now)
        return max((math.floor(place) + 1 - place) / (self.rate * self.speed), 0.0)

    def _at(self, now: float) -> float:
        if not self.playing:
            return self._frame
        return (self._frame + (now - self._since) * self.rate * self.speed) % self.frames

    def _touch(self, frame: float | int, now: float) -> None:
        self._frame, self._since = float(max(frame, 0.0)), now
