"""Small bodies, random poses, and the one check that every energy passes."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxcap.body.body import Body, pose_body
from jaxcap.body.body_model import BodyModel
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.body.retraction import retract
from jaxcap.body.shape_modes import ShapeModes
from jaxcap.body.skeleton import KINDS, Skeleton, make_skeleton
from jaxcap.body.skin import (
    AbstractPoseFeatures,
    AbstractSkin,
    CorrectedSkin,
    DualQuaternionSkin,
    LinearSkin,
    QuaternionFeatures,
    RigidSkin,
    RotationMatrixFeatures,
    SwingTwistSkin,
)
from jaxcap.energy.data.pairs import PointPairs

SKINS = ("rigid", "linear", "dual_quaternion", "swing_twist")
#: displacements by the pose before a skin
CORRECTED = ("corrected", "corrected_swing_twist", "corrected_low_rank")

_retract, _pose_body = eqx.filter_jit(retract), eqx.filter_jit(pose_body)


def chain_skeleton() -> Skeleton:
    """Nine joints of every kind, with one fork; centres and axes lie askew."""
    rng = np.random.default_rng(7)
    joints = [
        ("root", -1, "free"),
        ("spine", 0, "universal"),
        ("chest", 1, "ball"),
        ("slide", 2, "translate"),
        ("elbow", 3, "revolute"),
        ("hand", 4, "ball"),
        ("tool", 5, "fixed"),
        ("neck", 2, "ball"),
        ("jaw", 7, "revolute"),
    ]
    names, parents, kinds = zip(*joints, strict=True)
    centres = [[0, 0, 0], [0.1, 0, 0.02], [0.25, 0, 0], [0.4, 0, 0.1], [0.55, 0.02, 0.1], [0.7, 0, 0.1]]
    centres += [[0.8, 0, 0.1], [0.4, 0, -0.1], [0.5, 0.02, -0.12]]
    first = rng.normal(size=(len(joints), 3))
    second = np.cross(first, rng.normal(size=(len(joints), 3)))
    turned = rng.normal(size=(len(joints), 4))
    return make_skeleton(names, parents, kinds, centres, turned, np.stack([first, second], 1))


def chain_body(skin: str = "linear", rings: int = 4, sides: int = 4) -> Body:
    """A forked tube of three times `rings` by `sides` vertices around `chain_skeleton`, with a skin of `SKINS` or `CORRECTED`.

    Clouds need a finer tube than the first one: a tracker takes points far from all vertices for unexplained, and searches.
    """
    skeleton = chain_skeleton()
    rng = np.random.default_rng(8)
    vertices, faces = [], []
    for start, end in ((0, 2), (2, 6), (2, 8)):
        vertices, faces = _tube(vertices, faces, skeleton.centres[start], skeleton.centres[end], rings, sides)
    vertices = np.array(vertices) + 0.005 * rng.normal(size=(len(vertices), 3))
    apart = np.linalg.norm(vertices[:, None] - np.asarray(skeleton.centres)[None], axis=-1)
    weights = np.exp(-((apart / 0.12) ** 2))
    weights = jnp.asarray(weights / weights.sum(1, keepdims=True))
    bound = {
        "linear": lambda: LinearSkin(weights),
        "rigid": lambda: RigidSkin(jnp.asarray(np.argmin(apart, 1))),
        "dual_quaternion": lambda: DualQuaternionSkin(weights),
        "swing_twist": lambda: _forked_skin(skeleton, rng, jnp.asarray(np.argmin(apart, 1))),
        "corrected": lambda: _corrected(RotationMatrixFeatures(), LinearSkin(weights), rng),
        "corrected_swing_twist": lambda: _corrected(
            QuaternionFeatures(), _forked_skin(skeleton, rng, jnp.asarray(np.argmin(apart, 1))), rng
        ),
        "corrected_low_rank": lambda: _low_rank(LinearSkin(weights), rng),
    }[skin]()
    return Body(skeleton, bound, jnp.asarray(vertices), jnp.asarray(faces))


def chain_model(skin: str = "corrected", count: int = 4, rings: int = 4, sides: int = 4) -> BodyModel:
    """A chain whose surface and joints move smoothly with each coefficient."""
    body = chain_body(skin, rings, sides)
    rng = np.random.default_rng(3)
    bends = 0.05 * rng.normal(size=(count, 3, 3))

    def move(points):
        return np.einsum("kab,vb->kva", bends, np.asarray(points, float))

    modes = ShapeModes(jnp.asarray(move(body.skeleton.centres)), jnp.asarray(move(body.vertices)))
    own = jnp.asarray(rng.normal(size=count))
    return BodyModel(body, modes, own, groups=(("betas", count - 1), ("size", 1)), family="chain")


def _corrected(features: AbstractPoseFeatures, skin: AbstractSkin, rng: np.random.Generator):
    count = len(skin.dominant_bones())
    directions = 0.02 * rng.normal(size=(count, 3, features.num_features(9)))
    return CorrectedSkin(skin, features, jnp.asarray(directions))


def _low_rank(skin: AbstractSkin, rng: np.random.Generator):
    """Displacements by units of a linear layer; each has the features of one joint or of two."""
    features = RotationMatrixFeatures()
    layer = np.zeros((6, features.num_features(9)))
    for unit, joint in enumerate((0, 1, 1, 4, 7, 6)):
        layer[unit, 9 * joint : 9 * (joint + 1 + unit % 2)] = rng.normal(size=9 * (1 + unit % 2))
    directions = 0.02 * rng.normal(size=(len(skin.dominant_bones()), 3, len(layer)))
    return CorrectedSkin(skin, features, jnp.asarray(directions), jnp.asarray(layer), rectified=False)


def _forked_skin(skeleton: Skeleton, rng: np.random.Generator, bases) -> SwingTwistSkin:
    """Different weights for swing and twist of all children, some of them none, some all."""
    children = np.array(skeleton.parents)[None] == np.asarray(bases)[:, None]
    swing, twist = (children * rng.uniform(size=children.shape) for _ in range(2))
    swing, twist = (weights / np.maximum(weights.sum(1, keepdims=True), 1.0) for weights in (swing, twist))
    swing[::7], twist[::5] = 0.0, 0.0
    return SwingTwistSkin(jnp.asarray(bases), jnp.asarray(swing), jnp.asarray(twist))


class OtherSkin(AbstractSkin):
    """A skin that somebody else wrote: everything stays where it is."""

    def deform(self, vertices, skeleton, pose, transforms):
        return vertices

    def dominant_bones(self):
        return jnp.zeros(0, int)

    def bone_weights(self, num_bones):
        return jnp.zeros((0, num_bones))

    def take(self, vertices):
        return self

    def transfer(self, corners, barycentric, skeleton):
        return self

    def scaled(self, factor):
        return self

    def jacobian(self, vertices, directions, skeleton, pose, transforms, rates):
        return jnp.zeros((*directions.shape[:2], len(rates.joints)))


def random_pose(skeleton: Skeleton, rng: np.random.Generator, size: float = 0.5, scale: float = 1.0) -> Pose:
    """A pose whose tangent from rest has independent normal numbers of deviation `size`."""
    rest = rest_pose(skeleton)
    rest = eqx.tree_at(lambda pose: pose.scale, rest, jnp.asarray(scale, rest.scale.dtype))
    return _retract(skeleton, rest, jnp.asarray(size * rng.normal(size=skeleton.num_dofs)))


def half_turned_pose(skeleton: Skeleton, rng: np.random.Generator, short_of: float = 1e-3) -> Pose:
    """Every turning joint turned by `pi - short_of` radians about some axis of its own."""
    d = []
    for kind in skeleton.kinds:
        shifts, turns = KINDS[kind]
        direction = rng.normal(size=turns)
        length = np.linalg.norm(direction) if turns == 3 else np.abs(direction)
        d += [*(0.1 * rng.normal(size=shifts)), *((np.pi - short_of) * direction / np.maximum(length, 1e-9))]
    return _retract(skeleton, rest_pose(skeleton), jnp.asarray(d))


def awkward_poses(skeleton: Skeleton, seed: int = 0) -> list[Pose]:
    """Rest, small, ordinary and half-turned poses: where derivatives go wrong first."""
    rng = np.random.default_rng(seed)
    ordinary = [random_pose(skeleton, rng, size) for size in (1e-5, 0.5, 1.0)]
    return [rest_pose(skeleton), *ordinary, half_turned_pose(skeleton, rng)]


@eqx.filter_jit
def _residual(energy, body: Body, pose: Pose, d):
    return energy.residual(pose_body(body, retract(body.skeleton, pose, d)))


@eqx.filter_jit
def _derivatives(energy, body: Body, pose: Pose):
    """Residual and its Jacobian by forward and by reverse mode."""
    at = partial(_residual, energy, body, pose)
    still = jnp.zeros(body.skeleton.num_dofs, body.vertices.dtype)
    return at(still), jax.jacfwd(at)(still), jax.jacrev(at)(still)


@eqx.filter_jit
def _central_differences(energy, body: Body, pose: Pose, step: float):
    steps = step * jnp.eye(body.skeleton.num_dofs, dtype=body.vertices.dtype)
    slope = lambda d: (_residual(energy, body, pose, d) - _residual(energy, body, pose, -d)) / (2 * step)  # noqa: E731
    return jax.lax.map(slope, steps).T


def check_energy(energy, body: Body, poses=None, analytic=None, step: float = 1e-6, tolerance: float = 1e-6):
    """Hold the Jacobian of `energy.residual` to central differences, in float64.

    The Jacobian is that of `d -> residual(pose_body(body, retract(skeleton, pose, d)))` at
    `d = 0`; forward and reverse mode must agree with it within `tolerance`, relative to its
    largest number (or to one). `poses` stand beside the awkward ones. `analytic`, where
    given, maps a `Posed` to the Jacobian and must agree with autodiff to 1e-10.
    """
    for number, pose in enumerate([*awkward_poses(body.skeleton), *(poses or [])]):
        value, forward, reverse = _derivatives(energy, body, pose)
        assert np.isfinite(value).all(), f"the residual is not finite at pose {number}"
        numeric = _central_differences(energy, body, pose, step)
        scale = max(1.0, float(np.abs(numeric).max(initial=0.0)))
        for name, jacobian in (("forward", forward), ("reverse", reverse)):
            np.testing.assert_allclose(
                jacobian, numeric, rtol=0, atol=tolerance * scale, err_msg=f"{name} mode at pose {number}"
            )
        if analytic is not None:
            closed = analytic(_pose_body(body, pose))
            np.testing.assert_allclose(
                closed, forward, rtol=0, atol=1e-10 * scale, err_msg=f"closed form at pose {number}"
            )


def _tube(vertices, faces, start, end, rings: int, sides: int):
    """Add a closed-sided tube around the line from `start` to `end`."""
    start, end = np.asarray(start), np.asarray(end)
    along = (end - start) / np.linalg.norm(end - start)
    across = np.cross(along, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    up = np.cross(across, along)
    first = len(vertices)
    for share in np.linspace(0.0, 1.0, rings):
        for angle in 2 * np.pi * np.arange(sides) / sides:
            offset = 0.05 * (np.cos(angle) * across + np.sin(angle) * up)
            vertices = [*vertices, start + share * (end - start) + offset]
    for ring in range(rings - 1):
        for side in range(sides):
            a, b = (first + ring * sides + (side + i) % sides for i in range(2))
            faces = [*faces, [a, b, b + sides], [a, b + sides, a + sides]]
    return vertices, faces


def random_pairs(body: Body, rng, count: int = 40, corners: int = 1) -> PointPairs:
    """Pairs at vertices, or in triangles, some of them at a corner that is there three times."""
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    weights = rng.uniform(0, 1, count) * (np.arange(count) >= 4)
    if corners == 1:
        rows, shares = rng.integers(0, len(body.vertices), (count, 1)), np.ones((count, 1))
    else:
        rows = np.asarray(body.faces)[rng.integers(0, len(body.faces), count)]
        shares = rng.dirichlet(np.ones(3), count)
        rows[4:8] = rows[4:8, :1]
    points = np.einsum("ck,cka->ca", shares, np.asarray(body.vertices)[rows])
    points += 0.05 * rng.normal(size=(count, 3))
    along = rng.uniform(0, 1, count) * (np.arange(count) % 5 > 0)
    return PointPairs(
        jnp.asarray(rows, jnp.int32), *(jnp.asarray(x) for x in (shares, points, normals, weights, along))
    )
