"""Point constraints of inverse kinematics: as a user specifies them, and as arrays for a solver."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial.transform import Rotation

from ...arguments import check_fields, checked
from ...body.body import Body, take_vertices
from ...body.skeleton import Skeleton
from ...body.skin import RigidSkin
from ...observe.clouds import padded_size
from .constrained_skin import ConstrainedSkin

#: metres from a joint's centre to the points that constrain its orientation; a rotation by a twentieth of a
#: radian counts as much as a translation by a centimetre
ORIENTATION_OFFSET = 1.5**0.5 * 0.01 / 0.05
#: least size of padded arrays, and the factor to the next size; one more constraint rarely causes a
#: recompilation
MIN_POINTS, GROWTH_FACTOR = 16, 4


Position = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class Constraint(NamedTuple):
    """A target position for one point of a body (Kineben, section 4.2.1)."""

    #: index of a vertex, or name of a joint for its centre
    point: int | str
    #: target position, metres
    target: Position
    #: relative weight
    weight: float = 1.0
    #: pinned constraints take precedence over all others
    pinned: bool = False
    #: world rotation of a joint's bone from rest: a unit quaternion `wxyz`
    orientation: Quaternion | None = None


class Constraints(eqx.Module):
    """Constraints of one body as points with target positions, padded so that few array shapes occur.

    A point is a vertex, or fixed to a bone: a joint's centre, and for an orientation six points around it.
    All constraints so have the same form of residual, with one closed-form Jacobian. A weight of zero is
    padding.
    """

    vertices: Int[Array, "C"]
    #: if true, the point is at `rest (C, 3)` of a bone, otherwise at a vertex
    rigid: Bool[Array, "C"]
    bones: Int[Array, "C"]
    rest: Float[Array, "C 3"]
    targets: Float[Array, "C 3"]
    weights: Float[Array, "C"]
    pinned: Bool[Array, "C"]

    def __check_init__(self):
        check_fields(self)


@checked
def make_constraints(body: Body, constraints: Sequence[Constraint]) -> Constraints:
    """Make arrays of constraints, vertices first, padded to 16, 64, 256, ... points.

    An orientation `R` is expressed by points at `c +- a e_i` around the joint's centre `c`, with targets
    `y +- a R e_i` and a sixth of the weight each; `a` is `ORIENTATION_OFFSET`. Their sum is
    `w |c' - y|^2 + w (2/3) a^2 |theta|^2` to second order in the angle error `theta` of the bone, so position
    and orientation are decoupled.

    **Raises:** `InputError` with one sentence for a vertex or a joint that the body does not have, a
    duplicate, numbers that are not finite, a negative weight, or an orientation of a vertex.
    """
    check_constraints(constraints, body.skeleton, len(body.vertices))
    skeleton, dtype = body.skeleton, body.vertices.dtype
    rows: list[tuple] = [(c.point, False, 0, np.zeros(3), c.target, c.weight, c.pinned) for c in constraints if not isinstance(c.point, str)]  # fmt: skip
    centres = np.asarray(skeleton.centres, float)
    for c in constraints:
        if isinstance(c.point, str):
            joint = skeleton.index(c.point)
            for at, to, share in _orientation_points(c.orientation):
                rows.append((0, True, joint, centres[joint] + at, np.add(c.target, to), share * c.weight, c.pinned))  # fmt: skip
    spare = padded_size(len(rows), (MIN_POINTS,), GROWTH_FACTOR) - len(rows)
    rows += [(0, False, 0, np.zeros(3), np.zeros(3), 0.0, False)] * spare
    vertices, rigid, bones, rest, targets, weights, pinned = (
        np.array(column) for column in zip(*rows, strict=True)
    )
    return Constraints(
        jnp.asarray(vertices, jnp.int32),
        jnp.asarray(rigid, bool),
        jnp.asarray(bones, jnp.int32),
        jnp.asarray(rest, dtype),
        jnp.asarray(targets, dtype),
        jnp.asarray(weights, dtype),
        jnp.asarray(pinned, bool),
    )


def constrained_body(body: Body, constraints: Constraints) -> Body:
    """Reduce a body to the constrained points as its only vertices, in their order, without faces."""
    few = take_vertices(body, constraints.vertices)
    skin = ConstrainedSkin(few.skin, RigidSkin(constraints.bones), constraints.rigid)
    points = jnp.where(constraints.rigid[:, None], constraints.rest, few.vertices)
    return Body(few.skeleton, skin, points, few.faces)


def check_constraints(constraints: Sequence[Constraint], skeleton: Skeleton, num_vertices: int) -> None:
    """Check that constraints are valid for this skeleton and number of vertices; raises as
    `make_constraints`."""
    seen = set()
    for c in constraints:
        name = describe_point(c.point)
        if isinstance(c.point, str):
            if c.point not in skeleton.names:
                raise ValueError(
                    f"There is a constraint on {name}, but the skeleton has {', '.join(skeleton.names)}."
                )
        elif not 0 <= c.point < num_vertices:
            available = f"vertices 0 to {num_vertices - 1}" if num_vertices else "no vertices"
            raise ValueError(f"There is a constraint on {name}, but the body has {available}.")
        elif c.orientation is not None:
            raise ValueError(f"The constraint on {name} has an orientation; only joints can have one.")
        if c.point in seen:
            raise ValueError(f"There are two constraints on {name}; keep one of them.")
        seen.add(c.point)
        if len(c.target) != 3 or not all(map(math.isfinite, c.target)):
            raise ValueError(f"The target of {name} is {list(c.target)}; give three finite numbers, metres.")
        if not 0 <= c.weight < math.inf:
            raise ValueError(f"The weight of {name} is {c.weight:g}; give a number of at least 0.")
        turn = c.orientation
        if turn is not None and (len(turn) != 4 or not 0 < math.hypot(*turn) < math.inf):
            raise ValueError(f"The orientation of {name} is {list(turn)}; give a quaternion w, x, y, z.")


def describe_point(point: int | str) -> str:
    """Describe a point in words: `vertex 12`, `joint 'LeftHand'`."""
    return f"joint '{point}'" if isinstance(point, str) else f"vertex {point}"


def _orientation_points(orientation: Quaternion | None) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """List the offsets of points from a joint's centre at rest and from its target, and their shares."""
    if orientation is None:
        return [(np.zeros(3), np.zeros(3), 1.0)]
    turned = Rotation.from_quat(orientation, scalar_first=True).as_matrix()
    return [
        (sign * ORIENTATION_OFFSET * axis, sign * ORIENTATION_OFFSET * image, 1 / 6)
        for axis, image in zip(np.eye(3), turned.T, strict=True)
        for sign in (1.0, -1.0)
    ]
