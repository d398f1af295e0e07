"""Points of a body that are to reach places: as a user says them, and as arrays for a solver."""

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
from ...observe import padded_size
from .held_points import HeldSkin

#: metres from a joint's centre to the points that hold its orientation; a turn by a twentieth of a radian counts as
#: much as a shift by a centimetre
ARM = 1.5**0.5 * 0.01 / 0.05
#: the fewest points of padded arrays, and by how much more there are next: one more constraint compiles nothing
FEWEST, GROWTH = 16, 4


Place = tuple[float, float, float]
Turn = tuple[float, float, float, float]


class Constraint(NamedTuple):
    """One point of a body that is to reach a place (Kineben, section 4.2.1)."""

    #: index of a vertex, or name of a joint, whose centre it is
    point: int | str
    #: where it is to be, metres
    target: Place
    #: how much it counts beside the others
    weight: float = 1.0
    #: it comes before all that are not pinned
    pinned: bool = False
    #: how the bone of a joint is to be turned from rest, in the world: a unit quaternion `wxyz`
    orientation: Turn | None = None


class Constraints(eqx.Module):
    """Constraints of one body as points that are to reach places, of shapes that few counts of them share.

    A point is a vertex, or fixed to a bone: a joint's centre, and for an orientation six points around it. So
    all that is asked for is one kind of residual, with one closed Jacobian. A weight of zero is padding.
    """

    vertices: Int[Array, "C"]
    #: whether a point is at `rest (C, 3)` of a bone, and not at a vertex
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
    """Arrays of constraints, vertices first, padded to 16, 64, 256, ... points.

    An orientation `R` is asked for by points at `c +- ARM e_i` around the joint's centre `c`, with targets `y +- ARM R e_i`
    and a sixth of the weight each. Their sum is `w |c' - y|^2 + w (2/3) ARM^2 |theta|^2` to second order in the angle
    `theta` that the bone is off, so place and turn do not disturb each other.

    **Raises:** `InputError` with one sentence for a vertex or a joint that the body does not have, one that stands
    twice, numbers that are not finite, a weight below zero, or an orientation of a vertex.
    """
    check_constraints(constraints, body.skeleton, len(body.vertices))
    skeleton, dtype = body.skeleton, body.vertices.dtype
    rows: list[tuple] = [(c.point, False, 0, np.zeros(3), c.target, c.weight, c.pinned) for c in constraints if not isinstance(c.point, str)]  # fmt: skip
    centres = np.asarray(skeleton.centres, float)
    for c in constraints:
        if isinstance(c.point, str):
            joint = skeleton.index(c.point)
            for at, to, share in _around(c.orientation):
                rows.append((0, True, joint, centres[joint] + at, np.add(c.target, to), share * c.weight, c.pinned))  # fmt: skip
    spare = padded_size(len(rows), (FEWEST,), GROWTH) - len(rows)
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
    """The body with no vertices but the constrained points, in their order, and no faces."""
    few = take_vertices(body, constraints.vertices)
    skin = HeldSkin(few.skin, RigidSkin(constraints.bones), constraints.rigid)
    points = jnp.where(constraints.rigid[:, None], constraints.rest, few.vertices)
    return Body(few.skeleton, skin, points, few.faces)


def check_constraints(constraints: Sequence[Constraint], skeleton: Skeleton, num_vertices: int) -> None:
    """That constraints are of a body with this skeleton and so many vertices; raises as `make_constraints`."""
    seen = set()
    for c in constraints:
        name = describe(c.point)
        if isinstance(c.point, str):
            if c.point not in skeleton.names:
                raise ValueError(
                    f"There is a constraint on {name}, but the skeleton has {', '.join(skeleton.names)}."
                )
        elif not 0 <= c.point < num_vertices:
            held = f"vertices 0 to {num_vertices - 1}" if num_vertices else "no vertices"
            raise ValueError(f"There is a constraint on {name}, but the body has {held}.")
        elif c.orientation is not None:
            raise ValueError(f"The constraint on {name} has an orientation; only joints take one.")
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


def describe(point: int | str) -> str:
    """A point in words: `vertex 12`, `joint 'LeftHand'`."""
    return f"joint '{point}'" if isinstance(point, str) else f"vertex {point}"


def _around(orientation: Turn | None) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Where points are about a joint's centre at rest, where they are to be about its target, and their shares."""
    if orientation is None:
        return [(np.zeros(3), np.zeros(3), 1.0)]
    turned = Rotation.from_quat(orientation, scalar_first=True).as_matrix()
    return [
        (sign * ARM * axis, sign * ARM * image, 1 / 6)
        for axis, image in zip(np.eye(3), turned.T, strict=True)
        for sign in (1.0, -1.0)
    ]
