"""The current frame: a clock that can be paused, moved and played at other speeds.

The frame depends on the time alone. A slow window therefore skips frames and never lags.
"""

import math
from dataclasses import dataclass

#: factors of the playback speed
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)


@dataclass
class Timeline:
    """A loop over `frames` frames, `rate` of them a second.

    Times are seconds of any monotonic clock, such as `time.monotonic`.
    """

    frames: int
    rate: float
    playing: bool = False
    speed: float = 1.0
    #: the position in frames at the last change, and the time of it
    _frame: float = 0.0
    _since: float = 0.0

    def frame(self, now: float) -> int:
        """Return the frame to show."""
        return min(int(self._position(now)), self.frames - 1)

    def play(self, now: float) -> None:
        """Play, and restart from the first frame if at the last."""
        at = self.frame(now)
        self._set_position(0 if at == self.frames - 1 else at, now)
        self.playing = True

    def pause(self, now: float) -> None:
        """Pause at the current frame."""
        self._set_position(self.frame(now), now)
        self.playing = False

    def seek(self, frame: int, now: float) -> None:
        """Seek a frame, clamped to the timeline, and continue from there if playing."""
        self._set_position(min(max(frame, 0), self.frames - 1), now)

    def step(self, frames: int, now: float) -> None:
        """Stop and step by `frames`, back if negative, clamped to the first or last frame."""
        at = self.frame(now)
        self.playing = False
        self.seek(at + frames, now)

    def set_speed(self, speed: float, now: float) -> None:
        """Set the playback speed to `speed` times the rate."""
        self._set_position(self._position(now), now)
        self.speed = speed

    def grow(self, frames: int, now: float) -> None:
        """Set the number of frames, larger or smaller; the current frame stays if possible."""
        self._set_position(min(self._position(now), frames - 1), now)
        self.frames = max(frames, 1)

    def wait(self, now: float) -> float:
        """Compute the seconds until the next frame; infinite if paused."""
        if not self.playing or self.frames < 2:
            return math.inf
        place = self._position(now)
        return max((math.floor(place) + 1 - place) / (self.rate * self.speed), 0.0)

    def _position(self, now: float) -> float:
        if not self.playing:
            return self._frame
        return (self._frame + (now - self._since) * self.rate * self.speed) % self.frames

    def _set_position(self, frame: float | int, now: float) -> None:
        self._frame, self._since = float(max(frame, 0.0)), now
