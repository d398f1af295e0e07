"""Matched joints of two skeletons, and the treatment of unmatched ones."""

from collections.abc import Collection, Mapping
from typing import NamedTuple

from ...errors import InputError
from ..skeleton import Skeleton
from .upright_pose import UprightPose


class UnmatchedJoints(InputError):
    """An error: limbs have no match.

    `names` is an initial table; None if the given table states that a joint of the source has no match.
    `unassigned` are the joints of the source without any information.
    """

    def __init__(self, message: str, names: dict[str, str | None], unassigned: tuple[str, ...] = ()):
        super().__init__(message)
        self.names = names
        self.unassigned = unassigned


class JointMatches(NamedTuple):
    """The matching joints of a source and a target, by their indices."""

    source: Skeleton
    target: Skeleton
    #: target -> source, for the same joint of a person, or equal names
    pairs: dict[int, int]
    #: target -> (a, b, share): it rotates as `a` of the source does, or by `share` from `a` to `b`
    followed: dict[int, tuple[int, int, float]]
    #: the upright poses of both, with their persons
    references: tuple[UprightPose, UprightPose]
    #: sentences for the user
    warnings: tuple[str, ...]

    @property
    def names(self) -> dict[str, str | None]:
        """The joints of the source by name with those of the target, None without a match; ends of bones are
        omitted."""
        found = {here: there for there, here in self.pairs.items()}
        return {
            name: self.target.names[found[joint]] if joint in found else None
            for joint, name in enumerate(self.source.names)
            if joint in found or not _is_end(self.source, joint)
        }

    @property
    def unmatched_source(self) -> dict[str, str]:
        """Joints of the source without a match, and the treatment of their rotation."""
        used = {joint: self.target.names[there] for there, joint in self.pairs.items()}
        carried = dict(used)
        for there, (a, b, _) in self.followed.items():
            for joint in (a, b):
                carried.setdefault(joint, self.target.names[there])
        children: dict[int, list[int]] = {}
        for joint, parent in enumerate(self.source.parents):
            children.setdefault(parent, []).append(joint)
        found = {}
        for joint, name in enumerate(self.source.names):
            if joint in used or _is_end(self.source, joint):
                continue
            if joint in carried:
                found[name] = f"composed onto {carried[joint]}"
                continue
            below = _nearest_descendants(children, joint, set(carried))
            onto = sorted({carried[child] for child in below}, key=self.target.names.index)
            found[name] = (
                f"composed onto {', '.join(onto)}" if onto else "left out, as no descendant has a match"
            )
        return found

    @property
    def unmatched_target(self) -> dict[str, str]:
        """Joints of the target without a match, and their behaviour."""
        found = {}
        for joint, name in enumerate(self.target.names):
            if joint in self.pairs or _is_end(self.target, joint):
                continue
            if joint in self.followed:
                a, b, share = self.followed[joint]
                found[name] = (
                    f"rotates with {self.source.names[a]}"
                    if a == b
                    else f"interpolated, {share:.0%} from {self.source.names[a]} to {self.source.names[b]}"
                )
            else:
                parent = self.target.parents[joint]
                found[name] = "stays at rest" + (
                    f", moved by {self.target.names[parent]}" if parent >= 0 else ""
                )
        return found

    def lines(self) -> list[str]:
        """Describe the matches in sentences, one per line."""
        pairs = {self.source.names[here]: self.target.names[there] for there, here in self.pairs.items()}
        alike = [name for name, there in pairs.items() if name == there]
        other = [f"{name} = {there}" for name, there in pairs.items() if name != there]
        matched = ", ".join([*other, *([f"{len(alike)} of the same name"] if alike else [])])
        said = [f"{len(pairs)} joints of the source match a joint of the target: {matched}"]
        for which, found in (("source", self.unmatched_source), ("target", self.unmatched_target)):
            fates: dict[str, list[str]] = {}
            for name, fate in found.items():
                fates.setdefault(fate, []).append(name)
            said += [f"no match in the {which}: {', '.join(names)}: {fate}" for fate, names in fates.items()]
        frame = self.references[0].frame
        if frame is not None:
            said.append(
                f"the rest pose of the source is not upright; frame {frame}, the most upright one, replaces it"
            )
        return said


def initial_name_table(
    source: Skeleton, target: Skeleton, pairs: Mapping[int, int], unmatched: Collection[int]
) -> tuple[dict[str, str | None], tuple[str, ...]]:
    """Write pairs as a name table for `UnmatchedJoints`, with the source joints without information."""
    found = {here: target.names[there] for there, here in pairs.items()}
    names = {
        name: found.get(joint)
        for joint, name in enumerate(source.names)
        if joint in found or joint in unmatched
    }
    left = (
        name for joint, name in enumerate(source.names) if name not in names and not _is_end(source, joint)
    )
    return names, tuple(left)


def _is_end(skeleton: Skeleton, joint: int) -> bool:
    """Check whether a joint only marks the end of a bone."""
    return skeleton.kinds[joint] == "fixed" and joint not in skeleton.parents


def _nearest_descendants(children: dict[int, list[int]], joint: int, candidates: set[int]) -> list[int]:
    """Find the nearest of some joints on every path down from a joint."""
    found, waiting = [], [joint]
    while waiting:
        for child in children.get(waiting.pop(), []):
            (found if child in candidates else waiting).append(child)
    return found
