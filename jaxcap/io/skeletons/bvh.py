"""BVH files (Kineben, appendix A.6), read as other tools write them.

Rotation channels multiply in the order listed, the first outermost; they rotate about the world's axes at
rest, as this library's joints do. Position channels replace the joint's `OFFSET`, as in Blender and
MotionBuilder, for the root and other joints.

Channels determine the kind of a joint: three rotations a `ball`, two a `universal`, one a `revolute`,
positions a `translate`, both a `free`, none a `fixed` joint. An `End Site` becomes a `fixed` joint
`<parent>.end`, unless its offset is zero.
"""

import re
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from ...arguments import checked
from ...body.pose import Motion, Pose
from ...body.skeleton import Skeleton, make_skeleton
from ...errors import InputError
from ...units import unit_scale
from ..system.reader_errors import reader_of
from ..text import RATE_RANGE, parse_float_table, parse_floats, parse_int, read_text, shortened
from .bvh_writer import BvhWriter, write_bvh
from .twist_axes import END_SUFFIX, twist_orientations

__all__ = ["BvhWriter", "read_bvh", "write_bvh"]

_CHANNEL = re.compile(r"([xyz])(position|rotation)$", re.IGNORECASE)
#: largest number of frames of a motion without channels
MAX_STATIC_FRAMES = 100_000
_KINDS = ("fixed", "revolute", "universal", "ball")


class _Joint(NamedTuple):
    name: str
    parent: int
    line: int
    offset: list[float]
    #: such as ("position", "x")
    channels: list[tuple[str, str]]


@checked
@reader_of("a BVH file")
def read_bvh(path: str | Path, unit: str | float = "cm") -> tuple[Skeleton, Motion]:
    """Read the skeleton of a BVH file in metres, and its motion.

    **Arguments:** `unit` of the file's lengths: `m, dm, cm, mm, in, ft`, or the number of metres in one (the
    CMU database's own files need `0.0254 / 0.45`).

    **Raises:** `InputError` with file and line, if the file is invalid or cut short.
    """
    metres = unit_scale(unit)
    lines = _lines(read_text(path))
    start = next((i for i, (_, line) in enumerate(lines) if line.strip().lower() == "motion"), None)
    if start is None:
        raise InputError(f"{path}: the file has no MOTION section; it is incomplete.")
    joints = _HierarchyParser(lines[:start], path).joints()
    values, rate = _motion(lines[start + 1 :], sum(len(joint.channels) for joint in joints), path)
    return _make_motion(joints, values, rate, metres)


def _lines(text: str) -> list[tuple[int, str]]:
    """Number the lines and remove comments: from `#` or `//` at the start, or ` #` after values."""
    lines = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.strip()
        if not words or words.startswith(("#", "//")):
            continue
        if not words.upper().startswith(("ROOT", "JOINT")):
            line = re.split(r"\s#", line, maxsplit=1)[0]
        lines.append((number, line))
    return lines


class _HierarchyParser:
    """A parser of the joint tree: words and braces with their lines, in any layout."""

    def __init__(self, lines: list[tuple[int, str]], path):
        self.path = path
        self.words = [
            (n, m[0], line, m.end()) for n, line in lines for m in re.finditer(r"[{}]|[^\s{}]+", line)
        ]
        self.at = 0
        #: for each joint the line of its name
        self.lines: dict[str, int] = {}
        #: for each joint the number of names that were tried for its ends
        self.ends: dict[int, int] = {}

    def joints(self) -> list[_Joint]:
        found: list[_Joint] = []
        if self.peek().lower() == "hierarchy":
            self.take("a joint")
        while self.at < len(self.words):
            self.expect("ROOT", "ROOT or MOTION")
            self.joint(found)
        if not found:
            raise InputError(f"{self.path}: HIERARCHY has no ROOT joint; export the file again.")
        return found

    def joint(self, found: list[_Joint]) -> None:
        """Parse one joint with its descendants; with a stack, because chains may be long."""
        stack = [self.parse_joint_header(found, -1)]
        while stack:
            number, word = self.take("'}'")
            if word == "}":
                stack.pop()
            elif word.lower() == "joint":
                stack.append(self.parse_joint_header(found, stack[-1]))
            elif word.lower() == "end":
                self.expect("Site", "'Site'")
                self.end_site(found, stack[-1])
            else:
                raise InputError(
                    f"{self.path}:{number}: found '{shortened(word)}' in joint "
                    f"'{shortened(found[stack[-1]].name)}'; expected JOINT, End Site or '}}'."
                )

    def parse_joint_header(self, found: list[_Joint], parent: int) -> int:
        name, line = self.name()
        if name in self.lines:
            raise InputError(
                f"{self.path}:{line}: the joint '{shortened(name)}' occurs already in line {self.lines[name]}; "
                "names must be unique."
            )
        self.lines[name] = line
        self.expect("{", "'{'")
        offset, channels = [], []
        while self.peek().lower() in ("offset", "channels"):
            _, word = self.take("OFFSET")
            if word.lower() == "offset":
                offset = self.floats(3, f"the OFFSET of '{shortened(name)}'")
            else:
                channels = self.channels(name)
        if not offset:
            raise InputError(f"{self.path}:{line}: the joint '{shortened(name)}' has no OFFSET; add one.")
        found.append(_Joint(name, parent, line, offset, channels))
        return len(found) - 1

    def end_site(self, found: list[_Joint], parent: int) -> None:
        number, word = self.take("'{'")
        if word != "{":  # some tools name their end sites
            self.expect("{", "'{'")
        self.expect("OFFSET", "OFFSET")
        offset = self.floats(3, f"the End Site of '{found[parent].name}'")
        self.expect("}", "'}'")
        if any(offset):
            name = found[parent].name + END_SUFFIX
            count = self.ends.get(parent, 1)
            while name in self.lines:
                count += 1
                name = f"{found[parent].name}{END_SUFFIX}{count}"
            self.ends[parent], self.lines[name] = count, number
            found.append(_Joint(name, parent, number, offset, []))

    def channels(self, name: str) -> list[tuple[str, str]]:
        number, word = self.take("the number of CHANNELS")
        count = parse_int(word, f"{self.path}:{number}", f"the number of CHANNELS of '{shortened(name)}'")
        channels: list[tuple[str, str]] = []
        for _ in range(count):
            number, word = self.take("a channel")
            match = _CHANNEL.match(word)
            if not match:
                raise InputError(
                    f"{self.path}:{number}: '{shortened(word)}' is not a channel; joint '{shortened(name)}' declares {count} of "
                    "Xposition, Yposition, Zposition, Xrotation, Yrotation, Zrotation."
                )
            channel = (match[2].lower(), match[1].lower())
            if channel in channels:
                raise InputError(
                    f"{self.path}:{number}: the channel '{word}' of joint '{shortened(name)}' occurs twice; channels must be unique."
                )
            channels.append(channel)
        return channels

    def name(self) -> tuple[str, int]:
        """Parse a name: the rest of the line, or up to a brace, as names may contain blanks."""
        number, _, line, end = self.words[self.at - 1]
        name = re.split(r"[{}]", line[end:])[0].strip()
        if not name:
            raise InputError(f"{self.path}:{number}: a joint has no name; give it a name.")
        while (
            self.at < len(self.words)
            and self.words[self.at][0] == number
            and self.words[self.at][1] not in "{}"
        ):
            self.at += 1
        return name, number

    def floats(self, count: int, what: str) -> list[float]:
        numbers = []
        for _ in range(count):
            number, word = self.take(f"a number of {what}")
            numbers += parse_floats([word], f"{self.path}:{number}", what)
        return numbers

    def peek(self) -> str:
        return self.words[self.at][1] if self.at < len(self.words) else ""

    def take(self, wanted: str) -> tuple[int, str]:
        if self.at >= len(self.words):
            line = self.words[-1][0] if self.words else 1
            raise InputError(f"{self.path}:{line}: HIERARCHY ends before {wanted}; the file is cut short.")
        self.at += 1
        return self.words[self.at - 1][:2]

    def expect(self, word: str, wanted: str) -> None:
        number, found = self.take(wanted)
        if found.lower() != word.lower():
            raise InputError(f"{self.path}:{number}: found '{shortened(found)}'; expected {wanted}.")


def _motion(lines: list[tuple[int, str]], width: int, path) -> tuple[np.ndarray, float]:
    """Parse channel values `(F, width)` and the rate. Raises `InputError`."""
    if len(lines) < 2:
        raise InputError(
            f"{path}: 'Frames:' and 'Frame Time:' are missing after MOTION; the file is cut short."
        )
    (first, frames), (second, time), *rows = lines
    word = _parse_setting(frames, "frames", f"{path}:{first}", "Frames: <number>")
    count = parse_int(word, f"{path}:{first}", "the number of Frames")
    word = _parse_setting(time, "frame time", f"{path}:{second}", "Frame Time: <seconds>")
    seconds = parse_floats([word], f"{path}:{second}", "the Frame Time")[0]
    if not (seconds > 0 and count >= 0):
        raise InputError(
            f"{path}:{second}: there are {count} frames of {seconds:g} seconds each; expected at least 0 frames, and a time above 0."
        )
    if not 1 / RATE_RANGE[1] <= seconds <= 1 / RATE_RANGE[0]:
        raise InputError(
            f"{path}:{second}: the Frame Time is {seconds:g} seconds; expected {1 / RATE_RANGE[1]:g} to {1 / RATE_RANGE[0]:g}."
        )
    if width == 0 and count > MAX_STATIC_FRAMES:
        raise InputError(
            f"{path}:{first}: there are {count} frames, but the joints have no CHANNELS and do not move; remove the frames."
        )
    words = [line.split() for _, line in rows]
    total = sum(len(line) for line in words)
    if total != count * width:
        # if nearly all lines are complete frames, the odd line is the error
        odd = [n for (n, _), line in zip(rows, words, strict=True) if len(line) != width]
        if odd and len(odd) < 0.5 * len(rows) and not (total < count * width and odd[0] == rows[-1][0]):
            here = len(words[[n for n, _ in rows].index(odd[0])])
            raise InputError(
                f"{path}:{odd[0]}: this frame has {here} numbers; expected {width}, one for each channel."
            )
        ending = "the file is cut short" if total < count * width else "correct the number of Frames"
        raise InputError(
            f"{path}:{rows[-1][0] if rows else second}: there are {total} numbers for {count} frames of {width} "
            f"channels, which suffice for {total / max(width, 1):.4g} frames; {ending}."
        )
    values = parse_float_table([word for line in words for word in line])
    if values is None:
        # again line by line, for the line number in the error
        read = [
            parse_floats(line, f"{path}:{number}", "a frame")
            for (number, _), line in zip(rows, words, strict=True)
        ]
        values = np.array([number for line in read for number in line])
    rate = 1.0 / seconds
    # files round the frame time: 0.0083333 means 120 a second
    rate = float(round(rate)) if abs(rate - round(rate)) < 2e-5 * rate else rate
    return values.reshape(count, width), rate


def _parse_setting(line: str, name: str, where: str, wanted: str) -> str:
    """Return the single word after a name and an optional colon. Raises `InputError`."""
    words = line.replace(":", " ").lower().split()
    known = name.split()
    if words[:-1] != known:
        raise InputError(f"{where}: found '{shortened(line.strip())}'; expected '{wanted}'.")
    return words[-1]


def _make_motion(
    joints: list[_Joint], values: np.ndarray, rate: float, metres: float
) -> tuple[Skeleton, Motion]:
    frames, count = len(values), len(joints)
    centres, axes, kinds = np.zeros((count, 3)), np.tile(np.eye(3)[:2], (count, 1, 1)), []
    translations = np.zeros((frames, count, 3))
    rotations = np.tile([1.0, 0, 0, 0], (frames, count, 1))
    column = 0
    for j, joint in enumerate(joints):
        centres[j] = np.array(joint.offset) * metres + (centres[joint.parent] if joint.parent >= 0 else 0.0)
        turned, turns = Rotation.identity(frames), []
        for i, (what, letter) in enumerate(joint.channels):
            numbers, axis = values[:, column + i], "xyz".index(letter)
            if what == "position":
                translations[:, j, axis] = (numbers - joint.offset[axis]) * metres
            else:
                if frames:
                    turned = turned * Rotation.from_euler(letter, numbers[:, None], degrees=True)
                turns.append(np.eye(3)[axis])
        column += len(joint.channels)
        if turns and frames:
            rotations[:, j] = turned.as_quat(canonical=True, scalar_first=True)
        if len(turns) in (1, 2):
            axes[j, : len(turns)] = turns
        moves = len(turns) < len(joint.channels)
        kinds.append(("free" if turns else "translate") if moves else _KINDS[len(turns)])
    parents = [joint.parent for joint in joints]
    names = [joint.name for joint in joints]
    skeleton = make_skeleton(names, parents, kinds, centres, twist_orientations(centres, parents), axes)
    return skeleton, Motion(Pose(jnp.asarray(translations), jnp.asarray(rotations), jnp.ones(frames)), rate)
