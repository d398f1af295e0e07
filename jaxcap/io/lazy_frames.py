"""A sequence of named frames, loaded on access."""

from collections.abc import Callable, Iterator, Sequence
from typing import Generic, TypeVar, overload

T = TypeVar("T")


# without `[T]`, as a check of a sequence's type would load a frame
class LazyFrames(Sequence, Generic[T]):
    """Frames that are loaded on access, such as clouds or depth images; `names` and `len` load nothing."""

    def __init__(self, names: Sequence[str], load: Callable[[int], T]):
        self.names, self._load = tuple(names), load

    def with_loaded(self, number: int, frame: T) -> "LazyFrames[T]":
        """Return the same frames; the frame of this number is already loaded, and is kept in memory."""
        return LazyFrames(self.names, lambda i: frame if i == number else self._load(i))

    def __len__(self) -> int:
        return len(self.names)

    @overload
    def __getitem__(self, frame: int) -> T: ...
    @overload
    def __getitem__(self, frame: slice) -> "LazyFrames[T]": ...
    def __getitem__(self, frame):
        if isinstance(frame, slice):
            numbers = range(len(self))[frame]
            return LazyFrames([self.names[i] for i in numbers], lambda i: self._load(numbers[i]))
        return self._load(range(len(self))[frame])

    def __iter__(self) -> Iterator[T]:
        return (self._load(frame) for frame in range(len(self)))
