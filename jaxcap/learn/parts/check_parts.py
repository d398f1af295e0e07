"""Checks that the motion of the meshes distinguishes the rigid parts of a body."""

from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from ...body.body import Body
from ...body.kinematics import Transforms, forward_kinematics
from ...body.pose import Motion, Pose
from ...body.skeleton import Skeleton
from ...errors import join_names
from ...geometry.sampling import even_indices

#: parts that stay within this distance of each other or of their position are not distinguishable, share of
#: the body's length
INDISTINGUISHABLE = 0.003
#: vertices sampled from each part
NUM_SAMPLES = 40


def check_parts(
    rest: Float[np.ndarray, "V 3"],
    labels: Int[np.ndarray, "V"],
    rotations: Float[np.ndarray, "F K 3 3"],
    translations: Float[np.ndarray, "F K 3"],
    names: Sequence[str] | None = None,
) -> list[str]:
    """Return warnings about K rigid parts, one sentence each.

    They concern parts without vertices, parts that never move, and pairs that move alike, so that the joint
    between them is undetermined.

    **Arguments:** vertex `v` of part `labels[v]` moves from `rest[v]` to `rotations[f, k] v + translations[f,
    k]` in mesh `f`, metres; `names` are the names of the parts.
    """
    count = rotations.shape[1]
    called = [f"part {part}" for part in range(count)] if names is None else list(names)
    near = INDISTINGUISHABLE * float(np.ptp(rest, axis=0).max())
    members = [np.flatnonzero(labels == part) for part in range(count)]
    bare = [called[part] for part in range(count) if not members[part].size]
    messages = (
        [f"No vertex belongs to {join_names(bare)}, so that the motion is poorly determined."] if bare else []
    )
    chosen = [
        (part, rest[rows[even_indices(len(rows), NUM_SAMPLES)]])
        for part, rows in enumerate(members)
        if rows.size
    ]
    # positions of the vertices of one part under the motion of each part
    carried = {
        part: np.einsum("fkab,nb->fkna", rotations, few) + translations[:, :, None] for part, few in chosen
    }
    still = [part for part, _ in chosen if _spread(carried[part][:, part]) < near]
    if 0 < len(still) < len(chosen):
        guess = "" if len(still) == 1 else "; the joints between them are not determined"
        messages.append(f"No mesh moves {join_names([called[part] for part in still])}{guess}.")
    # distances of all pairs that move alike
    alike = np.zeros((count, count))
    for number, (a, _) in enumerate(chosen):
        for b, _ in chosen[number + 1 :]:
            distance = max(_rms(carried[i][:, a] - carried[i][:, b]) for i in (a, b))
            if distance < near and not (a in still and b in still):
                # at zero there would be no connection
                alike[a, b] = max(distance, 1e-9)
    if alike.any():
        messages.append(_describe_alike(alike, called))
    return messages


def _describe_alike(alike: Float[np.ndarray, "K K"], names: Sequence[str]) -> str:
    """Name the groups of parts that are connected by positive distances, metres."""
    groups = connected_components(scipy.sparse.csr_matrix(alike), directed=False)[1]
    members = [np.flatnonzero(groups == group) for group in np.unique(groups[alike.any(1)])]
    listed = "; ".join(join_names([names[part] for part in some.tolist()]) for some in members)
    return (
        f"These parts have the same motion within {1000 * alike.max():.1f} mm in all meshes: {listed}. Give meshes with "
        "relative motion between them, or fewer joints."
    )


def check_learned(body: Body, motion: Motion) -> list[str]:
    """Run `check_parts` on a learned body in the poses of its meshes.

    Parts are named by their joints, and a vertex belongs to the joint with the largest influence, or to the first joint above it
    that is not fixed.
    """
    skeleton = body.skeleton
    movers = np.arange(skeleton.num_joints)
    for joint, (kind, parent) in enumerate(zip(skeleton.kinds, skeleton.parents, strict=True)):
        if kind == "fixed" and parent >= 0:
            movers[joint] = movers[parent]
    transforms = _transforms(skeleton, motion.poses)
    moving, parts = np.unique(movers, return_inverse=True)
    return check_parts(
        np.asarray(body.vertices, float),
        parts[np.asarray(body.skin.bone_weights(skeleton.num_joints)).argmax(1)],
        np.asarray(transforms.rotations, float)[:, moving],
        np.asarray(transforms.translations, float)[:, moving],
        [skeleton.names[joint] for joint in moving.tolist()],
    )


@eqx.filter_jit
def _transforms(skeleton: Skeleton, poses: Pose) -> Transforms:
    return jax.lax.map(lambda pose: forward_kinematics(skeleton, pose), poses)


def _rms(gaps: Float[np.ndarray, "F N 3"]) -> float:
    return float(np.sqrt(np.mean(np.sum(gaps**2, -1))))


def _spread(positions: Float[np.ndarray, "F N 3"]) -> float:
    return _rms(positions - positions.mean(0))
