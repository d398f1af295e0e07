"""Compare derivatives of posed points: closed form, automatic differentiation, central differences.

    python -m benchmarks.gradients

In float64, over every kind of joint (a small forked chain, skinned and rigid) and over the
embedded human (skinned, rigid, two people), at rest, at random poses and next to half
turns. Closed form and autodiff agree to 1e-10, and with central differences to 1e-6, each
number's column taken relative to its own length. Run it from the root of the checkout.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.report import Timer, finish, progress
from jaxcap.body.body import Body, Posed, pose_body
from jaxcap.body.kinematics import world_axes
from jaxcap.body.people.human import human
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.body.retraction import retract
from jaxcap.body.skeleton import dof_layout
from jaxcap.body.skin import RigidSkin
from jaxcap.energy.priors.joint_limits import JointLimits
from jaxcap.fit.linearise import point_jacobian, vertex_jacobian
from jaxcap.geometry import rotation
from jaxcap.limits.ranges_and_cones import Cone, make_joint_ranges
from tests.helpers import chain_body, half_turned_pose, random_pose
from tests.kineben import ball_operator, cone_gradient, revolute_operator, translate_operator

RANDOM_POSES = 4
STEP = 1e-5


def displaced_vertices(body: Body, pose: Pose, d):
    """Compute the posed vertices after a tangent `d`, `(V, 3)` metres."""
    return pose_body(body, retract(body.skeleton, pose, d)).vertices


@eqx.filter_jit
def autodiff(body: Body, pose: Pose):
    return jax.jacfwd(lambda d: displaced_vertices(body, pose, d))(jnp.zeros(body.skeleton.num_dofs))


@eqx.filter_jit
def central_differences(body: Body, pose: Pose):
    """Compute central differences of fourth order, with rounding as the only error."""

    def slope(e):
        near, far = (
            displaced_vertices(body, pose, share * e) - displaced_vertices(body, pose, -share * e)
            for share in (1, 2)
        )
        return (8 * near - far) / (12 * STEP)

    return jnp.moveaxis(jax.lax.map(slope, STEP * jnp.eye(body.skeleton.num_dofs)), 0, -1)


@eqx.filter_jit
def closed_form(body: Body, pose: Pose):
    return vertex_jacobian(pose_body(body, pose))


@eqx.filter_jit
def projected(body: Body, pose: Pose, directions):
    vertices = jnp.arange(len(body.vertices))[:, None]
    return point_jacobian(pose_body(body, pose), vertices, directions[:, None, None])[:, 0]


posed_of = eqx.filter_jit(pose_body)


def paper_operators(body: Body, posed: Posed) -> np.ndarray:
    """Compute the Jacobian of a rigidly skinned body by Kineben's 4 x 4 operators, `(V, 3, D)`.

    Universal joints are two revolute ones.
    """
    skeleton, layout = body.skeleton, dof_layout(body.skeleton)
    points = np.concatenate([posed.vertices, np.ones((len(posed.vertices), 1))], 1)
    shifts, turns = world_axes(skeleton, posed.pose, posed.transforms)
    whole = posed.transforms.rotations / posed.pose.scale
    columns = np.zeros((len(points), 3, skeleton.num_dofs))
    for joint, kind in enumerate(skeleton.kinds):
        rides = skeleton.descendants[joint][np.asarray(body.skin.dominant_bones())][:, None]
        for number in range(3):
            shift, turn = layout.translations[joint, number], layout.rotations[joint, number]
            if shift < skeleton.num_dofs:
                operator = translate_operator(shifts[joint, number])
                columns[:, :, shift] = rides * (points @ np.asarray(operator).T)[:, :3]
            if turn < skeleton.num_dofs:
                spherical = kind in ("ball", "free")
                centre = posed.joints[joint]
                operator = (
                    ball_operator(whole[joint], centre, number)
                    if spherical
                    else revolute_operator(turns[joint, number], centre)
                )
                columns[:, :, turn] = rides * (points @ np.asarray(operator).T)[:, :3]
    return columns


def relative_error(one, other) -> float:
    """Compute the largest distance of two columns, relative to the longer one; a column shorter than a thousandth of the
    longest is relative to that thousandth."""
    one, other = (np.asarray(x).reshape(-1, x.shape[-1]) for x in (one, other))
    lengths = np.maximum(np.linalg.norm(one, axis=0), np.linalg.norm(other, axis=0))
    return float(np.max(np.linalg.norm(one - other, axis=0) / np.maximum(lengths, 1e-3 * lengths.max())))


def make_rigid(body: Body) -> Body:
    """Make a body rigid: every vertex follows one bone."""
    return eqx.tree_at(lambda b: b.skin, body, RigidSkin(body.skin.dominant_bones()))


def as_float64(tree):
    return jax.tree.map(lambda x: x.astype(jnp.float64) if eqx.is_inexact_array(x) else x, tree)


def poses_of(body: Body, rng: np.random.Generator) -> list[Pose]:
    skeleton = body.skeleton
    poses = [
        rest_pose(skeleton),
        random_pose(skeleton, rng, 1e-6),
        random_pose(skeleton, rng, 0.5, scale=1.1),
    ]
    poses += [random_pose(skeleton, rng, 1.0) for _ in range(RANDOM_POSES)]
    return poses + [half_turned_pose(skeleton, rng, short_of) for short_of in (1e-2, 1e-4)]


def cone_errors(rng: np.random.Generator, trials: int = 50) -> tuple[float, float]:
    """Compare Kineben's gradient of a cone (eq. 16) with autodiff and central differences; as a test of its sign, also with
    its negative."""
    closed, numeric = 0.0, 0.0

    @jax.jit
    def cosine(d, axis, q):
        return axis @ rotation.rotate(rotation.multiply(q, rotation.exp(d)), axis)

    slope = jax.jit(jax.grad(cosine))
    for trial in range(trials):
        axis = rng.normal(size=3)
        axis = jnp.asarray(axis / np.linalg.norm(axis))
        w = rng.normal(size=3)
        angle = 0.0 if trial == 0 else np.pi - 1e-6 if trial == 1 else rng.uniform(0.1, 3.0)
        q = rotation.exp(jnp.asarray(angle * w / np.linalg.norm(w)))
        gradient = cone_gradient(axis, rotation.to_matrix(q))
        steps = [(cosine(e, axis, q) - cosine(-e, axis, q)) / (2 * STEP) for e in STEP * jnp.eye(3)]
        closed = max(closed, float(np.abs(gradient - slope(jnp.zeros(3), axis, q)).max()))
        numeric = max(numeric, float(np.abs(gradient - np.array(steps)).max()))
    return closed, numeric


def limit_errors(body: Body, rng: np.random.Generator, trials: int = 12) -> tuple[float, float]:
    """Compare derivatives of joint limits (eqs. 14 and 42) on the chain: autodiff, the closed form (slope one beyond a range,
    eq. 16 beyond a cone, else zero) and central differences."""
    skeleton = body.skeleton
    ranges = {"elbow": (-0.3, 0.2), "spine": ((-0.1, 0.4), (-0.2, 0.3)), "jaw": (-0.5, -0.1)}
    cones = {"chest": Cone((1, 0, 0), 0.3, (0, 1, 0), 0.2), "hand": Cone((0, 1, 1), 0.5, (1, 0, 0), 2.0)}
    limits = make_joint_ranges(skeleton, ranges, cones)
    energy, layout = JointLimits(limits), dof_layout(skeleton)

    @eqx.filter_jit
    def residual(pose, d):
        return energy.residual(pose_body(body, retract(skeleton, pose, d)))

    slope = eqx.filter_jit(lambda pose: jax.jacfwd(lambda d: residual(pose, d))(jnp.zeros(skeleton.num_dofs)))
    closed, numeric = 0.0, 0.0
    for _ in range(trials):
        pose = random_pose(skeleton, rng, 0.7)
        value, expected = residual(pose, jnp.zeros(skeleton.num_dofs)), []
        slots = layout.rotations[np.asarray(limits.joints), np.asarray(limits.angle_indices)]
        expected += [np.eye(skeleton.num_dofs)[slot] for slot in slots]
        for axes in (limits.heading, limits.bank):
            for joint, axis in zip(np.asarray(limits.ball_joints), axes, strict=True):
                row = np.zeros(skeleton.num_dofs)
                row[layout.rotations[joint]] = cone_gradient(axis, rotation.to_matrix(pose.rotations[joint]))
                expected.append(row)
        expected = np.where(np.asarray(value)[:, None] != 0, np.array(expected), 0.0)
        steps = STEP * jnp.eye(skeleton.num_dofs)
        central = np.stack([(residual(pose, e) - residual(pose, -e)) / (2 * STEP) for e in steps], 1)
        closed = max(closed, float(np.abs(slope(pose) - expected).max()))
        numeric = max(numeric, float(np.abs(slope(pose) - central).max()))
    return closed, numeric


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    rng = np.random.default_rng(0)
    people = {"man": {"sex": "male"}, "child": {"sex": "female", "age": 10}}
    skinned = {"chain": chain_body()}
    skinned |= {name: as_float64(human(**who, resolution="low")) for name, who in people.items()}
    bodies = skinned | {
        f"{name}, rigid": make_rigid(body) for name, body in skinned.items() if name != "child"
    }
    seconds: dict[str, dict[str, dict[str, float]]] = {}
    figures = dict.fromkeys(
        (
            "autodiff_closed_form",
            "projected",
            "paper_operators",
            "closed_form_differences",
            "autodiff_differences",
        ),
        0.0,
    )

    def worst(name: str, error: float) -> None:
        figures[name] = max(figures[name], error) if np.isfinite(error) else float("inf")

    count = 0
    for name, body in bodies.items():
        directions = jnp.asarray(rng.normal(size=body.vertices.shape))
        # every body has its own shapes, and compiles anew
        timers = {way: Timer() for way in ("autodiff", "closed_form", "differences")}
        for pose in poses_of(body, rng):
            exact = timers["autodiff"](autodiff, body, pose)
            analytic = timers["closed_form"](closed_form, body, pose)
            numeric = timers["differences"](central_differences, body, pose)
            worst("autodiff_closed_form", relative_error(analytic, exact))
            worst("closed_form_differences", relative_error(analytic, numeric))
            worst("autodiff_differences", relative_error(exact, numeric))
            rows = jnp.einsum("va,vad->vd", directions, exact)
            worst("projected", relative_error(projected(body, pose, directions), rows))
            if isinstance(body.skin, RigidSkin):
                worst("paper_operators", relative_error(paper_operators(body, posed_of(body, pose)), exact))
            count += 1
        seconds[name] = {way: timer.seconds for way, timer in timers.items()}
        progress(
            f"{name}: {body.skeleton.num_dofs} degrees of freedom, {len(body.vertices)} vertices; largest errors so far {figures}"
        )
    figures["cone_closed_form"], figures["cone_differences"] = cone_errors(rng)
    figures["limits_closed_form"], figures["limits_differences"] = limit_errors(skinned["chain"], rng)
    exact_ones = (
        "autodiff_closed_form",
        "projected",
        "paper_operators",
        "cone_closed_form",
        "limits_closed_form",
    )
    limits = {name: ("<=", 1e-10 if name in exact_ones else 1e-6) for name in figures}
    sizes = {"poses": count, "vertices": {name: len(body.vertices) for name, body in bodies.items()}}
    sizes["numbers"] = {name: body.skeleton.num_dofs for name, body in bodies.items()}
    sizes["kinds"] = sorted({kind for body in bodies.values() for kind in body.skeleton.kinds})
    finish("gradients", figures, limits, sizes, seconds)


if __name__ == "__main__":
    main()
