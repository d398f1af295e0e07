"""Swing-twist weights of single vertices: candidate twist weights, with optimal swing weights for each.

For given twist weights a vertex is linear in its swing weights, so that these are a least-squares problem
over the simplex. Candidates of twist weights (Adaptation, 3.2.2) slide along the chain: towards and from each
child of the base, past the base's joint to its parent, and past a child to its children. Gauss-Newton steps
in swing and twist together are additional candidates, which the thesis does not have. They converge in a few
sweeps, where slides alone need ever smaller steps.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...body.joint_swing_twist import decompose_joints
from ...body.kinematics import forward_kinematics
from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ...body.skin import SwingTwistSkin
from ...fit.solvers.simplex_least_squares import simplex_least_squares

#: candidates other than slides: the current twists, and two lengths of the Gauss-Newton step
STEPS = (0.0, 1.0, 0.5)
#: the number of surface neighbours whose twists are tried
NUM_NEIGHBOURS = 2


class SwingTwistRows(eqx.Module):
    """Sparse weights of vertices: slot `k` belongs to the `k`-th child of the base."""

    bases: Int[Array, "V"]
    swing: Float[Array, "V K"]
    twist: Float[Array, "V K"]


class SwingTwistWeightSolver(eqx.Module):
    """Tables of skeleton and poses to solve for swing-twist weights, frames last."""

    #: children of each bone, padded with J
    children: Int[Array, "J K"]
    #: the next base and slot when weights slide past a joint; padded with -1
    passes: Int[Array, "J M 2"]
    #: true for the pass to the parent
    upward: Bool[Array, "J M"]
    #: row J is the identity
    twists: Float[Array, "I 8 F"]
    swings: Float[Array, "I 12 F"]
    rotations: Float[Array, "J 9 F"]
    translations: Float[Array, "J 3 F"]
    scales: Float[Array, "F"]

    @property
    def num_candidates(self) -> int:
        return len(STEPS) + NUM_NEIGHBOURS + 2 * self.children.shape[1] + self.passes.shape[1]

    def solve(
        self,
        rows: SwingTwistRows,
        neighbour_rows: list[SwingTwistRows],
        rest: Float[Array, "C 3 N"],
        target_offsets: Float[Array, "C 3 F"],
        slide_length: Float[Array, ""],
        relaxation: Float[Array, ""],
        num_candidates: Int[Array, ""],
    ) -> tuple[SwingTwistRows, Float[Array, "C 3 F"], Float[Array, "C"]]:
        """Choose the best of the first `num_candidates` candidates for each vertex.

        Returns the weights, the displacement of the vertex, and the decrease of its squared distance to the
        aim.

        **Arguments:** `neighbour_rows` are the weights of neighbours; `rest` vertices, metres, one column for all frames or one for each; `target_offsets` are the
        displacements from the current positions to the goals; `slide_length` is the length of slides; `relaxation` scales
        the aims when weights are solved for (over-relaxation). Candidates are compared by the unscaled aims.
        """
        current = self._posed_positions(rows, rest)
        goal, far = current + target_offsets, current + relaxation * target_offsets
        bases, twists = self._candidates(rows, neighbour_rows, rest, far, slide_length)

        def compare(i, best):
            chosen, place, cost = best
            tried = SwingTwistRows(bases[i], jnp.zeros_like(rows.swing), twists[i])
            tried, where, left = self._fit_swing(tried, rest, goal, far)
            better = left < cost
            pick = lambda a, b: jnp.where(better.reshape(-1, *(1,) * (a.ndim - 1)), a, b)  # noqa: E731
            return jax.tree.map(pick, tried, chosen), pick(where, place), jnp.where(better, left, cost)

        before = jnp.sum(target_offsets**2, (1, 2))
        chosen, place, cost = jax.lax.fori_loop(0, num_candidates, compare, (rows, current, before))
        return self._normalise_base(chosen), place - current, before - cost

    def _fit_swing(self, rows: SwingTwistRows, rest, goal, far):
        """Solve for the swing weights that move the vertices nearest to `far`.

        Also returns the positions, and their squared distances to `goal`.
        """
        twisted, swung = self._images(rows, rest)
        gap = self._into_base(rows.bases, far) - twisted
        swing = _nearest(swung, gap * self.scales**2, self.scales**2, self._is_child(rows.bases))
        place = self._into_world(rows.bases, twisted + jnp.einsum("ck,ckaf->caf", swing, swung))
        return SwingTwistRows(rows.bases, swing, rows.twist), place, jnp.sum((goal - place) ** 2, (1, 2))

    def _candidates(self, rows: SwingTwistRows, lent: list[SwingTwistRows], rest, far, slide):
        """Build candidate bases (N, C) and twist weights (N, C, K)."""
        step = self._newton(rows, rest, far) - rows.twist
        bases = [rows.bases] * len(STEPS) + [row.bases for row in lent]
        bases += [rows.bases] * (2 * self.children.shape[1])
        twists = [rows.twist + share * step for share in STEPS] + [row.twist for row in lent]
        slots = jnp.eye(self.children.shape[1], dtype=rows.twist.dtype)
        real = self._is_child(rows.bases)
        for slot in slots:
            towards = jnp.minimum(rows.twist + slide * slot, 1.0)
            others = jnp.sum(towards * (1 - slot), 1, keepdims=True)
            room = 1.0 - jnp.sum(towards * slot, 1, keepdims=True)
            squeeze = jnp.minimum(1.0, room / jnp.where(others > 0, others, 1.0))
            towards = towards * jnp.where(slot > 0, 1.0, squeeze)
            twists += [jnp.where(real, towards, 0.0), jnp.maximum(rows.twist - slide * slot, 0.0)]
        for i in range(self.passes.shape[1]):
            base, slot = self.passes[rows.bases, i, 0], self.passes[rows.bases, i, 1]
            weight = jnp.where(self.upward[rows.bases, i], 1.0 - slide, slide)
            open_to = base >= 0
            bases.append(jnp.where(open_to, base, rows.bases))
            twists.append(jnp.where(open_to[:, None], weight[:, None] * slots[slot], rows.twist))
        return jnp.stack(bases), jnp.stack(twists)

    def _newton(self, rows: SwingTwistRows, rest, far) -> Float[Array, "C K"]:
        """Compute the twist weights after a Gauss-Newton step in swing and twist together."""
        twisted, swung = self._images(rows, rest)
        slopes = self._slopes(rows, rest)
        motions = self.swings[self.children[rows.bases]]
        # blended swing rotation, applied to displacements of the twisted vertex
        blend = jnp.einsum("ck,ckmf->cmf", rows.swing, motions - self.swings[-1])
        slopes = slopes + jnp.stack(
            [sum(blend[:, None, 4 * a + b] * slopes[:, :, b] for b in range(3)) for a in range(3)], 2
        )
        gap = self._into_base(rows.bases, far) - twisted - jnp.einsum("ck,ckaf->caf", rows.swing, swung)
        now = jnp.concatenate([rows.twist, rows.swing], 1)
        columns = jnp.concatenate([slopes, swung], 1)
        gap = gap + jnp.einsum("ck,ckaf->caf", now, columns)
        real = self._is_child(rows.bases)
        count = real.shape[1]
        groups = tuple(i // count for i in range(2 * count))
        solved = _nearest(
            columns, gap * self.scales**2, self.scales**2, jnp.concatenate([real, real], 1), now, groups
        )
        return solved[:, :count]

    def _images(self, rows: SwingTwistRows, rest):
        """Compute, in the base's rest frame, the twisted vertices and their displacement by each child's full
        swing.

        Shapes (C, 3, F) and (C, K, 3, F).
        """
        children = self.children[rows.bases]
        twisted = _move(self._blend(rows)[0], rest)
        swings = (self.swings - self.swings[-1])[children]
        swung = jnp.stack(
            [
                sum(swings[:, :, 4 * a + b] * twisted[:, None, b] for b in range(3)) + swings[:, :, 4 * a + 3]
                for a in range(3)
            ],
            2,
        )
        return twisted, swung

    def _slopes(self, rows: SwingTwistRows, rest) -> Float[Array, "C K 3 F"]:
        """Compute the derivatives of the twisted vertices by the twist weights."""
        blend, motions, still = self._blend(rows)

        def along(k):
            return jax.jvp(lambda d: _move(d, rest), (blend,), (motions[:, k] - still,))[1]

        return jnp.stack([along(k) for k in range(motions.shape[1])], 1)

    def _blend(self, rows: SwingTwistRows):
        """Compute the weighted sum of twists (C, 8, F).

        Also returns the twists (C, K, 8, F) and the identity (C, 8, F), with their signs in the sum.
        """
        motions, neutral = self.twists[self.children[rows.bases]], 1.0 - jnp.sum(rows.twist, 1)
        first, signs = _signs(rows.twist, neutral, motions[:, :, :4])
        motions, still = signs[:, :, None] * motions, first[:, None] * self.twists[-1]
        blend = jnp.einsum("ck,ckdf->cdf", rows.twist, motions) + neutral[:, None, None] * still
        return blend, motions, still

    def _posed_positions(self, rows: SwingTwistRows, rest):
        twisted, swung = self._images(rows, rest)
        return self._into_world(rows.bases, twisted + jnp.einsum("ck,ckaf->caf", rows.swing, swung))

    def _into_world(self, bases, points):
        r = self.rotations[bases]
        turned = [sum(r[:, 3 * a + b] * points[:, b] for b in range(3)) for a in range(3)]
        return jnp.stack(turned, 1) + self.translations[bases]

    def _into_base(self, bases, points):
        r, away = self.rotations[bases], (points - self.translations[bases]) / self.scales**2
        return jnp.stack([sum(r[:, 3 * b + a] * away[:, b] for b in range(3)) for a in range(3)], 1)

    def _is_child(self, bases):
        return self.children[bases] < len(self.children)

    def _normalise_base(self, rows: SwingTwistRows) -> SwingTwistRows:
        """Replace the base by a child that has all the weight."""
        whole = jnp.minimum(rows.swing, rows.twist) > 1.0 - 4 * jnp.finfo(rows.twist.dtype).eps
        passed = jnp.any(whole, 1)
        child = jnp.take_along_axis(self.children[rows.bases], jnp.argmax(whole, 1)[:, None], 1)[:, 0]
        keep = jnp.where(passed, 0.0, 1.0)[:, None].astype(rows.twist.dtype)
        return SwingTwistRows(jnp.where(passed, child, rows.bases), rows.swing * keep, rows.twist * keep)


def make_swing_twist_weight_solver(skeleton: Skeleton, poses: Pose) -> SwingTwistWeightSolver:
    """Build the tables of a skeleton in stacked poses."""
    children, passes, upward = _tree(skeleton)
    motions = _motions(skeleton, poses)
    return SwingTwistWeightSolver(jnp.asarray(children), jnp.asarray(passes), jnp.asarray(upward), *motions)


def skin_to_rows(solver: SwingTwistWeightSolver, skin: SwingTwistSkin) -> SwingTwistRows:
    """Convert the weights of a skin to sparse rows."""
    children = solver.children[skin.bases]
    pick = lambda w: jnp.where(  # noqa: E731
        children < w.shape[1], jnp.take_along_axis(w, jnp.minimum(children, w.shape[1] - 1), 1), 0.0
    )
    return SwingTwistRows(skin.bases, pick(skin.swing), pick(skin.twist))


def rows_to_skin(solver: SwingTwistWeightSolver, rows: SwingTwistRows) -> SwingTwistSkin:
    """Convert sparse rows to a skin."""
    children = solver.children[rows.bases]
    lines = jnp.arange(len(children))[:, None]
    wide = jnp.zeros((len(children), len(solver.children)), rows.swing.dtype)
    spread = lambda w: wide.at[lines, children].set(w, mode="drop")  # noqa: E731
    return SwingTwistSkin(rows.bases, spread(rows.swing), spread(rows.twist))


def _tree(skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    parents = np.array(skeleton.parents)
    lists = [np.flatnonzero(parents == joint).tolist() for joint in range(len(parents))]
    width = max(1, *(len(row) for row in lists))
    children = np.array([row + [len(parents)] * (width - len(row)) for row in lists], np.int32)
    passes = []
    for joint, parent in enumerate(parents):
        up = [(parent, lists[parent].index(joint))] if parent >= 0 else []
        passes.append(up + [(child, slot) for child in lists[joint] for slot in range(len(lists[child]))])
    room = max(1, *(len(row) for row in passes))
    table = np.array([row + [(-1, 0)] * (room - len(row)) for row in passes], np.int32)
    upward = (np.arange(room) == 0) & (parents >= 0)[:, None]
    return children, table, upward


@eqx.filter_jit
def _motions(skeleton: Skeleton, poses: Pose):
    split = jax.vmap(lambda pose: decompose_joints(skeleton, pose))(poses)
    bones = jax.vmap(lambda pose: forward_kinematics(skeleton, pose))(poses)
    frames, joints = bones.translations.shape[:2]
    still = jnp.zeros((1, 8, frames), split.twists.dtype).at[:, 0].set(1.0)
    rest = jnp.broadcast_to(jnp.eye(3, 4, dtype=still.dtype).reshape(1, 12, 1), (1, 12, frames))
    last = lambda array: jnp.moveaxis(array.reshape(frames, joints, -1), 0, -1)  # noqa: E731
    return (
        jnp.concatenate([last(split.twists), still]),
        jnp.concatenate([last(split.swings), rest]),
        last(bones.rotations),
        last(bones.translations),
        poses.scale,
    )


def _nearest(columns, gap, scales, real, start=None, groups=None):
    """Solve for the weights of columns (C, K, 3, F) nearest to the gap; their sum may be less than one."""
    count, width = columns.shape[:2]
    groups = groups or (0,) * width
    number = max(groups) + 1
    flat = columns.reshape(count, width, -1)
    gram = jnp.einsum("ckf,clf->ckl", flat, (columns * scales).reshape(count, width, -1))
    linear = jnp.einsum("ckf,cf->ck", flat, gap.reshape(count, -1))
    gram = jnp.pad(gram, ((0, 0), (0, number), (0, number)))
    linear = jnp.pad(linear, ((0, 0), (0, number)))
    start = jnp.zeros((count, width), linear.dtype) if start is None else start
    member = jnp.asarray(np.equal.outer(groups, np.arange(number)), start.dtype)
    start = jnp.concatenate([start, jnp.maximum(1.0 - start @ member, 0.0)], 1)
    allowed = jnp.concatenate([real, jnp.ones((count, number), bool)], 1)
    solved = simplex_least_squares(gram, linear, start, allowed, (*groups, *range(number)))
    return solved[:, :width]


def _signs(twist, neutral, reals):
    """Compute signs as in `dual_quaternions.align`: the hemisphere is that of the motion with the largest weight.

    Returns the signs of the identity (C, F) and of the children (C, K, F).
    """
    most = jnp.argmax(jnp.concatenate([neutral[:, None], twist], 1), 1)
    still = jnp.zeros_like(reals[:, :1]).at[:, :, 0].set(1.0)
    every = jnp.concatenate([still, reals], 1)
    leader = jnp.take_along_axis(every, most[:, None, None, None], 1)
    signs = jnp.where(jnp.sum(every * leader, 2) < 0, -1.0, 1.0).astype(twist.dtype)
    return signs[:, 0], signs[:, 1:]


def _move(motion: Float[Array, "C 8 F"], rest: Float[Array, "C 3 N"]) -> Float[Array, "C 3 F"]:
    """Apply `dual_quaternions.apply` with frames last."""
    a0, v0, ae, ve = motion[:, :1], motion[:, 1:4], motion[:, 4:5], motion[:, 5:]
    squared = jnp.sum(motion[:, :4] ** 2, 1, keepdims=True)
    points = jnp.broadcast_to(rest, v0.shape)
    turned = _cross(v0, _cross(v0, points) + a0 * points)
    return points + 2.0 * (turned + a0 * ve - ae * v0 + _cross(v0, ve)) / squared


def _cross(a, b):
    return jnp.stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ],
        1,
    )
