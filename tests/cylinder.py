"""A cylinder with a joint in its middle, under every skinning scheme, and the measures of the
artefacts that bending and twisting it make."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxcap.body.body import Body, pose_body
from jaxcap.body.pose import rest_pose
from jaxcap.body.skeleton import make_skeleton
from jaxcap.body.skin import DualQuaternionSkin, LinearSkin, RigidSkin, SwingTwistSkin
from jaxcap.geometry import rotation

SCHEMES = ("rigid", "linear", "dual_quaternion", "swing_twist")
#: metres: like a lower leg, along x, the joint at the origin
RADIUS, LENGTH, BLEND = 0.05, 0.4, 0.2
RINGS, SIDES = 81, 48

_pose = eqx.filter_jit(pose_body)


def cylinder(scheme: str) -> Body:
    """Two bones along x; the second one's weight grows smoothly over `BLEND` about the joint."""
    skeleton = make_skeleton(["upper", "lower"], [-1, 0], ["fixed", "ball"], [[-LENGTH / 2, 0, 0], [0, 0, 0]])
    angles = 2 * np.pi * np.arange(SIDES) / SIDES
    along = np.linspace(-LENGTH / 2, LENGTH / 2, RINGS)
    ring = RADIUS * np.stack([0 * angles, np.cos(angles), np.sin(angles)], 1)
    vertices = (along[:, None, None] * [1.0, 0, 0] + ring).reshape(-1, 3)
    first = np.arange(RINGS - 1)[:, None] * SIDES + np.arange(SIDES)
    after = first - np.arange(SIDES) + (np.arange(SIDES) + 1) % SIDES
    quads = np.stack([first, first + SIDES, after + SIDES, after], -1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 2, 1]], quads[:, [0, 3, 2]]])
    share = np.clip(vertices[:, 0] / BLEND + 0.5, 0.0, 1.0)
    share = share * share * (3 - 2 * share)
    weights = jnp.asarray(np.stack([1 - share, share], 1))
    child = weights.at[:, 0].set(0.0)
    skin = {
        "rigid": RigidSkin(jnp.asarray((vertices[:, 0] > 0).astype(int))),
        "linear": LinearSkin(weights),
        "dual_quaternion": DualQuaternionSkin(weights),
        "swing_twist": SwingTwistSkin(jnp.zeros(len(vertices), int), child, child),
    }[scheme]
    return Body(skeleton, skin, jnp.asarray(vertices), jnp.asarray(faces))


def posed_cylinder(scheme: str, motion: str, degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles after a `twist` about x or a `swing` about y of the second bone."""
    body = cylinder(scheme)
    axis = {"twist": [1.0, 0, 0], "swing": [0, 1.0, 0]}[motion]
    turn = rotation.about_axis(jnp.array(axis), jnp.asarray(np.radians(degrees)))
    pose = rest_pose(body.skeleton)
    pose = eqx.tree_at(lambda pose: pose.rotations, pose, pose.rotations.at[1].set(turn))
    return np.asarray(_pose(body, pose).vertices), np.asarray(body.faces)


def cross_section(vertices: np.ndarray) -> float:
    """Area of the ring in the joint's middle, as a share of the area at rest."""
    ring = vertices.reshape(RINGS, SIDES, 3)[RINGS // 2]
    sides = ring - ring.mean(0)
    area = np.linalg.norm(np.cross(sides, np.roll(sides, -1, 0)).sum(0)) / 2
    return float(area / (SIDES / 2 * np.sin(2 * np.pi / SIDES) * RADIUS**2))


def bulge(vertices: np.ndarray, degrees: float) -> float:
    """How far the surface reaches beyond its radius from the axes of the two bones, the second one
    swung by `degrees`, as a share of the radius."""
    angle = np.radians(degrees)
    axes = np.array([[-1.0, 0, 0], [np.cos(angle), 0, -np.sin(angle)]])
    feet = np.maximum(vertices @ axes.T, 0.0)[..., None] * axes
    return float(np.linalg.norm(vertices[:, None] - feet, axis=-1).min(1).max() / RADIUS - 1)


def thickness(vertices: np.ndarray) -> float:
    """Least distance of the ring in the joint's middle from the joint's centre, as a share of the
    radius: what the bend has left of the limb."""
    ring = vertices.reshape(RINGS, SIDES, 3)[RINGS // 2]
    return float(np.linalg.norm(ring, axis=1).min() / RADIUS)
