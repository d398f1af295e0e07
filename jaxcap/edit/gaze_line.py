"""The line of a gaze: from the back of the head to between the eyes, fixed to the head; and the joints that turn it."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body
from ..body.people.human import human
from ..body.skeleton import Skeleton
from ..body.symmetry import twin_joints
from ..geometry.axes import nearest_axis

#: of the embedded human, by resolution: vertices whose mean is the back of the head, and between the eyes
HUMAN = {
    "full": ((955,), (169,)),
    "medium": ((262,), (11, 29)),
    "low": ((71, 819), (3, 762)),
}
#: chest, neck and head have these parts of the turn (Adaptation, section 4.2.3)
SHARES = (0.1, 0.4, 0.5)


class GazeLine(eqx.Module):
    """What looks: a ray fixed to a joint's bone, in the rest frame."""

    joint: int = eqx.field(static=True)
    #: between the eyes, metres
    eyes: Float[Array, "3"]
    #: of unit length
    direction: Float[Array, "3"]


def line_of_vertices(
    body: Body, back: Sequence[int] | int, front: Sequence[int] | int, head: str
) -> GazeLine:
    """The line from one vertex, or the mean of some, at the back of the head, to one or some between the eyes.

    **Raises:** `ValueError` where the body has no such vertices or joint, or both ends are in one place.
    """
    ends = []
    for name, chosen in (("back of the head", back), ("middle between the eyes", front)):
        rows = np.atleast_1d(np.asarray(chosen, int))
        if rows.size == 0 or rows.min() < 0 or rows.max() >= len(body.vertices):
            raise ValueError(
                f"The vertices {rows.tolist()} for the {name} are not all in the body, which has "
                f"{len(body.vertices)}: 0 to {len(body.vertices) - 1}."
            )
        ends.append(np.asarray(body.vertices, float)[rows].mean(0))
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    if length < 1e-6:
        raise ValueError(
            f"The vertices {np.atleast_1d(back).tolist()} and {np.atleast_1d(front).tolist()} are in one place, so no "
            "line goes through them."
        )
    dtype = body.skeleton.centres.dtype
    joint = _joint(body.skeleton, head)
    return GazeLine(joint, jnp.asarray(ends[1], dtype), jnp.asarray(along / length, dtype))


def line_of_joint(skeleton: Skeleton, head: str) -> GazeLine:
    """The line of a skeleton without a known surface: from the middle of the head's bone to the front, which is where
    its left, by names, and its vertical at rest say.

    **Raises:** `ValueError` where there is no such joint, or left and right cannot be told.
    """
    joint, centres = _joint(skeleton, head), np.asarray(skeleton.centres, float)
    below = [child for child, parent in enumerate(skeleton.parents) if parent == joint]
    eyes = centres[joint] if not below else 0.5 * (centres[joint] + centres[below].mean(0))
    dtype = skeleton.centres.dtype
    return GazeLine(joint, jnp.asarray(eyes, dtype), jnp.asarray(_forward(skeleton, joint), dtype))


def human_line(body: Body) -> GazeLine | None:
    """The line of the embedded human, whose own triangles tell its vertices; None for any other body."""
    for resolution, (back, front) in HUMAN.items():
        faces = np.asarray(human(resolution=resolution).faces)  # pyright: ignore[reportArgumentType]
        if faces.shape == body.faces.shape and np.array_equal(faces, np.asarray(body.faces)):
            return line_of_vertices(body, back, front, "Head") if "Head" in body.skeleton.names else None
    return None


def gaze_shares(skeleton: Skeleton, names: Sequence[str] | None = None) -> dict[str, float]:
    """Chest, neck and head with their shares of the turn, 10, 40 and 50 per cent.

    **Arguments:** `names` of the three joints in that order; where they are not given, the head is the joint called
    so, the neck the uppermost joint above it that is called so, and the chest what the neck hangs on.

    **Raises:** `ValueError` where names are not three, or none or several joints are called so.
    """
    if names is not None:
        if len(names) != len(SHARES):
            raise ValueError(f"{len(names)} joints are named for the gaze; name three: chest, neck and head.")
        return dict(zip(names, SHARES, strict=True))
    ask = "name chest, neck and head"
    heads = [joint for joint, name in enumerate(skeleton.names) if _plain(name) == "head"]
    if len(heads) != 1:
        raise ValueError(
            f"{len(heads)} of the joints are called head; {ask}, of {', '.join(skeleton.names)}."
        )
    neck, above = -1, skeleton.parents[heads[0]]
    while above >= 0 and "neck" in _plain(skeleton.names[above]):
        neck, above = above, skeleton.parents[above]
    if neck < 0 or above < 0:
        raise ValueError(
            f"Above '{skeleton.names[heads[0]]}' no joint is called neck with another above it; {ask}, of "
            f"{', '.join(skeleton.names)}."
        )
    found = [skeleton.names[joint] for joint in (above, neck, heads[0])]
    return dict(zip(found, SHARES, strict=True))


def _plain(name: str) -> str:
    """In small letters, without any `prefix:` and without `_` and blanks; ASF's upper neck is a neck."""
    return name.rsplit(":", 1)[-1].lower().replace("_", "").replace(" ", "").removeprefix("bip01")


def _joint(skeleton: Skeleton, name: str) -> int:
    if name not in skeleton.names:
        raise ValueError(f"There is no joint '{name}'; the skeleton has {', '.join(skeleton.names)}.")
    return skeleton.names.index(name)


def _forward(skeleton: Skeleton, head: int) -> np.ndarray:
    """The front at rest: left crossed with up, both along coordinate axes."""
    pairs = np.array(twin_joints(skeleton.names)).reshape(-1, 2)
    centres = np.asarray(skeleton.centres, float)
    left = (centres[pairs[:, 0]] - centres[pairs[:, 1]]).sum(0)
    root = head
    while skeleton.parents[root] >= 0:
        root = skeleton.parents[root]
    front = np.cross(nearest_axis(left), nearest_axis(centres[head] - centres[root]))
    if np.linalg.norm(front) < 0.5:
        raise ValueError(
            "Where the front of this skeleton is cannot be told from the names of its joints; give vertices of its head."
        )
    return front
