"""How large an actor is against the template, once the first poses fit (Adaptation, 4.1.4)."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..body.body import Body, pose_body
from ..body.pose import Pose
from ..body.pose_boxes import PoseBoxes
from ..energy.term import AbstractEnergy
from ..fit.correspond import Matching, Pairs, Scan, places_on
from ..geometry.camera import Camera
from .equations import pair_rows
from .pose import fit_pose, pairs_of

#: an actor is between these sizes of the template
SMALLEST, LARGEST = 0.5, 2.0


def fit_size(
    body: Body,
    scans: Sequence[Scan],
    poses: Sequence[Pose],
    prior: AbstractEnergy,
    matching: Matching,
    weight: float,
    rounds: int = 12,
    cameras: Sequence[Camera] = (),
    boxes: PoseBoxes | None = None,
) -> tuple[Body, list[Pose], float]:
    """The body as large as the actor, its poses in some scans, and how large: in turn a step of every pose and one of
    the size that all of them share. Joints and vertices do the rest later. `cameras` and `boxes` as in `fit_pose`."""
    poses, size = list(poses), 1.0
    for _ in range(rounds):
        poses = [
            fit_pose(
                body, scan, pose, prior, matching, weight=weight, steps=2, cameras=cameras, boxes=boxes
            ).pose
            for scan, pose in zip(scans, poses, strict=True)
        ]
        told = [size_equation(body, pose, pairs_of(body, pose, scan, matching, cameras)) for scan, pose in zip(scans, poses, strict=True)]  # fmt: skip
        top, bottom = (sum(float(part[i]) for part in told) for i in range(2))
        # nearest neighbours hold a surface back where it is far off, so a step goes further
        step = 1.0 + 1.5 * top / max(bottom, 1e-12)
        step = min(max(step, SMALLEST / size), LARGEST / size)
        size *= step
        body = resized(body, jnp.asarray(step, body.vertices.dtype))
        # a root that is not at the origin moves with the size of its rest place
        root = (1.0 - step) * body.skeleton.centres[0] / step
        poses = [Pose(p.translations.at[0].add(root), p.rotations, p.scale) for p in poses]
        if abs(step - 1.0) < 1e-3:
            break
    return body, poses, size


def resized(body: Body, size: Float[Array, ""]) -> Body:
    """The body at rest, so many times as large about the origin."""
    return eqx.tree_at(
        lambda b: (b.vertices, b.skeleton.centres), body, (body.vertices * size, body.skeleton.centres * size)
    )


@eqx.filter_jit
def size_equation(body: Body, pose: Pose, pairs: Pairs) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """What pairs say of the size, as `(J^T r, J^T J)` by its logarithm; it grows from the root's joint."""
    posed = pose_body(body, pose)
    places = places_on(pairs, posed.vertices)
    rows = pair_rows(pairs)
    along = jnp.einsum("cra,ca->cr", rows, places - posed.joints[0])
    apart = jnp.einsum("cra,ca->cr", rows, pairs.points - places)
    return jnp.sum(along * apart), jnp.sum(along**2)
