"""The gaze line, from the back of the head to the point between the eyes, and the joints that rotate it."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..arguments import checked
from ..body.body import Body
from ..body.people.human import human
from ..body.skeleton import Skeleton
from ..body.symmetry import left_right_pairs_by_name
from ..geometry.axes import nearest_axis

#: of the embedded human, by resolution: vertices whose means are the back of the head and the point between
#: the eyes
HUMAN_VERTICES = {
    "full": ((955,), (169,)),
    "medium": ((262,), (11, 29)),
    "low": ((71, 819), (3, 762)),
}
#: fractions of the rotation for chest, neck and head (Adaptation, section 4.2.3)
SHARES = (0.1, 0.4, 0.5)


class GazeLine(eqx.Module):
    """The gaze as a ray that is fixed to a joint's bone, in the rest frame."""

    joint: int = eqx.field(static=True)
    #: point between the eyes, metres
    eyes: Float[Array, "3"]
    #: unit vector
    direction: Float[Array, "3"]


@checked
def gaze_line_of_vertices(
    body: Body, back: Sequence[int] | int, front: Sequence[int] | int, head: str
) -> GazeLine:
    """Make a gaze line from vertices at the back of the head to vertices between the eyes.

    Each end is one vertex, or the mean of several.

    **Raises:** `ValueError` if the body has no such vertices or joint, or both ends coincide.
    """
    ends = []
    for name, chosen in (("back of the head", back), ("point between the eyes", front)):
        rows = np.atleast_1d(np.asarray(chosen, int))
        if rows.size == 0 or rows.min() < 0 or rows.max() >= len(body.vertices):
            raise ValueError(
                f"The vertices {rows.tolist()} for the {name} are not all in the body, which has "
                f"{len(body.vertices)} vertices; give at least one from 0 to {len(body.vertices) - 1}."
            )
        ends.append(np.asarray(body.vertices, float)[rows].mean(0))
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    if length < 1e-6:
        raise ValueError(
            f"The vertices {np.atleast_1d(back).tolist()} and {np.atleast_1d(front).tolist()} have the same mean "
            "position, so they define no gaze line; give vertices at different positions."
        )
    dtype = body.skeleton.centres.dtype
    joint = _joint_index(body.skeleton, head)
    return GazeLine(joint, jnp.asarray(ends[1], dtype), jnp.asarray(along / length, dtype))


@checked
def gaze_line_of_joint(skeleton: Skeleton, head: str) -> GazeLine:
    """Make a gaze line for a skeleton without a known surface, from the middle of the head's bone to the
    front.

    The front is computed from the skeleton's left, by joint names, and its vertical at rest.

    **Raises:** `ValueError` if there is no such joint, or left and right cannot be determined.
    """
    joint, centres = _joint_index(skeleton, head), np.asarray(skeleton.centres, float)
    below = [child for child, parent in enumerate(skeleton.parents) if parent == joint]
    eyes = centres[joint] if not below else 0.5 * (centres[joint] + centres[below].mean(0))
    dtype = skeleton.centres.dtype
    return GazeLine(joint, jnp.asarray(eyes, dtype), jnp.asarray(_front_direction(skeleton, joint), dtype))


@checked
def human_gaze_line(body: Body) -> GazeLine | None:
    """Make the gaze line of the embedded human, which is recognised by its triangles; None for any other
    body."""
    for resolution, (back, front) in HUMAN_VERTICES.items():
        faces = np.asarray(human(resolution=resolution).faces)  # pyright: ignore[reportArgumentType]
        if faces.shape == body.faces.shape and np.array_equal(faces, np.asarray(body.faces)):
            return gaze_line_of_vertices(body, back, front, "Head") if "Head" in body.skeleton.names else None
    return None


@checked
def gaze_shares(skeleton: Skeleton, names: Sequence[str] | None = None) -> dict[str, float]:
    """Find chest, neck and head with their shares of the rotation, 10, 40 and 50 per cent.

    **Arguments:** `names` of the three joints in that order. If they are not given, they are found by name:
    the head, the uppermost neck joint above it, and as chest the parent of that neck joint.

    **Raises:** `ValueError` if there are not three names, or none or several joints have such a name.
    """
    if names is not None:
        if len(names) != len(SHARES):
            raise ValueError(f"{len(names)} joints are named for the gaze; name three: chest, neck and head.")
        return dict(zip(names, SHARES, strict=True))
    ask = "name chest, neck and head"
    heads = [joint for joint, name in enumerate(skeleton.names) if _normalised_name(name) == "head"]
    if len(heads) != 1:
        raise ValueError(
            f"{len(heads)} of the joints are called head; {ask}, from {', '.join(skeleton.names)}."
        )
    neck, above = -1, skeleton.parents[heads[0]]
    while above >= 0 and "neck" in _normalised_name(skeleton.names[above]):
        neck, above = above, skeleton.parents[above]
    if neck < 0 or above < 0:
        raise ValueError(
            f"No ancestor of '{skeleton.names[heads[0]]}' is a neck joint with a parent; {ask}, from "
            f"{', '.join(skeleton.names)}."
        )
    found = [skeleton.names[joint] for joint in (above, neck, heads[0])]
    return dict(zip(found, SHARES, strict=True))


def _normalised_name(name: str) -> str:
    """Convert a joint name to lower case, without `prefix:`, `_` and blanks; ASF's upper neck is a neck."""
    return name.rsplit(":", 1)[-1].lower().replace("_", "").replace(" ", "").removeprefix("bip01")


def _joint_index(skeleton: Skeleton, name: str) -> int:
    if name not in skeleton.names:
        raise ValueError(f"There is no joint '{name}'; the skeleton has {', '.join(skeleton.names)}.")
    return skeleton.names.index(name)


def _front_direction(skeleton: Skeleton, head: int) -> np.ndarray:
    """Compute the front at rest: the cross product of left and up, both along coordinate axes."""
    pairs = np.array(left_right_pairs_by_name(skeleton.names)).reshape(-1, 2)
    centres = np.asarray(skeleton.centres, float)
    left = (centres[pairs[:, 0]] - centres[pairs[:, 1]]).sum(0)
    root = head
    while skeleton.parents[root] >= 0:
        root = skeleton.parents[root]
    front = np.cross(nearest_axis(left), nearest_axis(centres[head] - centres[root]))
    if np.linalg.norm(front) < 0.5:
        raise ValueError(
            "The front of this skeleton cannot be determined from the names of its joints; give vertices of its "
            "head."
        )
    return front
