"""Points of a retargeted body brought to where the source's are, in its own size: hands together, feet on the floor."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body, pose_body
from ..body.pose import Motion, Pose
from ..body.skeleton import Skeleton
from ..body.skin import RigidSkin
from ..energy.landmarks import JointLandmarks, VertexLandmarks
from ..energy.prior import PosePrior, tangent_deviations
from ..fit.solve import solve
from .retarget import UP

#: standard deviations of a pair of weight one, metres, and of the pose from what it was, metres and radians
MET, SLIDES, TURNS = 0.001, 0.05, 0.2


class PointPair(NamedTuple):
    """One point of the source and one of the target: a vertex by its number, or a joint by its name."""

    source: int | str
    target: int | str
    #: how much it counts beside others, at least 0
    weight: float = 1.0


class Met(NamedTuple):
    """A motion, and by how much its points miss their places."""

    motion: Motion
    #: (F, K) metres, for every pair
    distances: Float[np.ndarray, "F K"]


def meet_points(
    moved: Motion,
    target: Body | Skeleton,
    motion: Motion,
    source: Body | Skeleton,
    pairs: Sequence[PointPair],
    *,
    ratio: float = 1.0,
    floor: float = 0.0,
) -> Met:
    """The motion `moved` of the target, as `retarget` gives it, changed as little as it takes for its points to be where
    those of the source's `motion` are.

    Every frame is solved by itself from its own pose, which a `PosePrior` draws it back to: what the points do not ask for
    stays.

    **Arguments:** `ratio` target metres for one of the source, about the origin and the `floor`: 1 brings points to the
    very places, where they touch things; `size_ratio` to those of the target's own size.

    **Raises:** `ValueError` where there are no pairs, a body does not have a point, vertices are named of a skeleton
    without a surface, motions have other lengths, or a weight is not a number above 0.
    """
    if not pairs:
        raise ValueError("No pairs of points are given; give one at least.")
    if len(moved) != len(motion):
        raise ValueError(
            f"The motions have {len(moved)} and {len(motion)} frames; give the one that was retargeted."
        )
    if not 0 < ratio < np.inf:
        raise ValueError(f"The ratio of sizes is {ratio:g}; it must be above 0.")
    for pair in pairs:
        if not 0 < pair.weight < np.inf:
            raise ValueError(
                f"The pair {pair.source} and {pair.target} weighs {pair.weight:g}; give more than 0."
            )
    here = _Points(target, [pair.target for pair in pairs], "target")
    there = _Points(source, [pair.source for pair in pairs], "source")
    places = ratio * there.places(motion.poses) + (1.0 - ratio) * floor * UP
    weights = np.array([pair.weight for pair in pairs]) / MET**2
    dtype = here.body.skeleton.centres.dtype
    poses = _solve_frames(
        here.body,
        here.rows,
        here.joints,
        moved.poses,
        jnp.asarray(places, dtype),
        jnp.asarray(weights, dtype),
    )
    reached = here.places(poses)
    return Met(Motion(poses, moved.rate), np.linalg.norm(reached - places, axis=-1))


class _Points:
    """Some points of a body, which has no other vertices than those."""

    def __init__(self, owner: Body | Skeleton, points: Sequence[int | str], which: str):
        skeleton = owner if isinstance(owner, Skeleton) else owner.skeleton
        for point in points:
            if isinstance(point, str):
                if point not in skeleton.names:
                    raise ValueError(
                        f"There is no joint '{point}' in the {which}, which has {', '.join(skeleton.names)}."
                    )
            elif isinstance(owner, Skeleton):
                raise ValueError(
                    f"Vertex {point} of the {which} is asked for, which is a skeleton without a surface; name a joint."
                )
            elif not 0 <= point < len(owner.vertices):
                raise ValueError(
                    f"There is no vertex {point} in the {which}, which has {len(owner.vertices)}: 0 to {len(owner.vertices) - 1}."
                )
        vertices = np.array([point for point in points if not isinstance(point, str)], int)
        none = jnp.zeros((0, 3), int)
        if isinstance(owner, Skeleton) or len(vertices) == 0:
            self.body = Body(
                skeleton, RigidSkin(jnp.zeros(0, int)), jnp.zeros((0, 3), skeleton.centres.dtype), none
            )
        else:
            self.body = Body(skeleton, owner.skin.take(jnp.asarray(vertices)), owner.vertices[vertices], none)
        #: of every point, its row among the vertices and its joint; -1 where it is the other
        rows, joints, found = [], [], 0
        for point in points:
            rows.append(-1 if isinstance(point, str) else found)
            joints.append(skeleton.names.index(point) if isinstance(point, str) else -1)
            found += not isinstance(point, str)
        self.rows, self.joints = tuple(rows), tuple(joints)

    def places(self, poses: Pose) -> Float[np.ndarray, "F K 3"]:
        vertices, joints = (np.asarray(x, float) for x in _places(self.body, poses))
        columns = [
            joints[:, joint] if joint >= 0 else vertices[:, row]
            for row, joint in zip(self.rows, self.joints, strict=True)
        ]
        return np.stack(columns, 1)


@eqx.filter_jit
def _places(body: Body, poses: Pose) -> tuple[Float[Array, "F V 3"], Float[Array, "F J 3"]]:
    def one(pose):
        posed = pose_body(body, pose)
        return posed.vertices, posed.joints

    return jax.lax.map(one, poses)


@eqx.filter_jit
def _solve_frames(body: Body, rows, joints, poses: Pose, places, weights) -> Pose:
    skeleton = body.skeleton
    on_skin = np.flatnonzero(np.array(joints) < 0)
    on_bone = np.flatnonzero(np.array(joints) >= 0)
    deviations = tangent_deviations(skeleton, SLIDES, TURNS)

    def one(frame):
        pose, place = frame
        energy = PosePrior(pose, deviations)
        if len(on_bone):
            # a joint may stand in several pairs: the mean of their places, with all their weight
            which = np.array(joints)[on_bone]
            total = jnp.zeros(skeleton.num_joints, place.dtype).at[which].add(weights[on_bone])
            sums = (
                jnp.zeros((skeleton.num_joints, 3), place.dtype)
                .at[which]
                .add(weights[on_bone, None] * place[on_bone])
            )
            energy = JointLandmarks(sums / jnp.where(total > 0, total, 1.0)[:, None], total) + energy
        if len(on_skin):
            which = jnp.asarray(np.array(rows)[on_skin])
            energy = VertexLandmarks(which, place[on_skin], weights[on_skin]) + energy
        return solve(energy, body, pose).pose

    return jax.lax.map(one, (poses, places))
