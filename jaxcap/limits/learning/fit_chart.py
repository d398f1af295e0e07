"""The chart of a joint's samples: number of angles, axes, and centre."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ..chart import Chart
from .samples import JointSamples

#: a joint has fewer angles than three if its rotations deviate by less than this, radians
AXIS_TOLERANCE = np.radians(1.0)
#: largest distance of a rotation from the centre, radians: half a turn away they wrap
MAX_ANGLE = np.radians(170.0)
#: number of steps to the centre of a range
STEPS = 300


class FullTurnError(ValueError):
    """A joint that turns through a full turn, so that no chart contains its rotations."""

    def __init__(self, joint: str, span: float):
        super().__init__(
            f"Joint '{joint}' rotates through {np.degrees(span):.0f} degrees; its range is not within half a turn of "
            "any centre, so it has no limits; leave it out."
        )
        self.span = span


def find_chart(samples: JointSamples, least: int = 1) -> Chart:
    """Choose a chart, one angle, two angles or a quaternion, and centre it on the samples.

    The chart follows the kind of the joint; for joints with free rotation it follows the samples. `least` is
    the smallest number of angles of these.

    **Raises:** `FullTurnError` where rotations reach half a turn from every centre.
    """
    kinds = {"revolute": "hinge", "universal": "universal"}
    kind, axes, base = kinds.get(samples.kind, "ball"), samples.axes, np.array([1.0, 0.0, 0.0, 0.0])
    if kind == "ball" and least < 3:
        kind, axes, base = _find_axes(samples.rotations)
    if kind == "ball":
        middle = middle_rotation(samples.rotations)
        furthest = _angle(samples.rotations, middle).max()
        if furthest > MAX_ANGLE:
            raise FullTurnError(samples.joint, 2 * furthest)
        return Chart(jnp.asarray(middle), jnp.asarray(axes), "ball")
    raw = Chart(jnp.asarray(base), jnp.asarray(axes), "hinge" if kind == "hinge" else "universal")
    angles = 2 * chart_coordinates(raw, samples.rotations)
    middles = [_middle_angle(angles[:, i], samples.joint) for i in range(raw.dimension)]
    middle = _rotation(base) * _rotation(_quaternion_about(axes[0], middles[0]))
    if kind == "universal":
        # the second axis rotates with the first angle, so the first middle angle precedes both, and the
        # second is absorbed by the axis of the first
        second = _rotation(_quaternion_about(axes[1], middles[1]))
        middle, axes = middle * second, np.stack([second.inv().apply(axes[0]), axes[1]])
    return Chart(jnp.asarray(middle.as_quat(scalar_first=True)), jnp.asarray(axes), raw.kind)


def chart_coordinates(chart: Chart, rotations: Float[np.ndarray, "F 4"]) -> Float[np.ndarray, "F 3"]:
    """Compute the chart coordinates of rotations, in double precision where JAX has it."""
    return np.asarray(_chart_coordinates(chart, jnp.asarray(rotations)), float)


@jax.jit
def _chart_coordinates(chart: Chart, rotations):
    return jax.vmap(chart.coordinates)(rotations)


def middle_rotation(rotations: Float[np.ndarray, "F 4"]) -> Float[np.ndarray, "4"]:
    """Find the centre of the smallest ball around the rotations (Badoiu and Clarkson 2003).

    From the mean, shrinking steps go towards the farthest sample.
    """
    middle = _rotation(rotations).mean().as_quat(scalar_first=True)
    for step in range(2, STEPS):
        cosines = rotations @ middle
        furthest = int(np.argmin(np.abs(cosines)))
        towards = rotations[furthest] * (1.0 if cosines[furthest] >= 0 else -1.0)
        middle = middle + (towards - middle) / step
        middle /= np.linalg.norm(middle)
    return middle


def _find_axes(rotations: Float[np.ndarray, "F 4"]) -> tuple[str, np.ndarray, np.ndarray]:
    """Determine the number of angles, the axes and the base rotation of a joint with free rotation."""
    turns, still = _rotation(rotations), np.array([1.0, 0.0, 0.0, 0.0])
    mean = turns.mean()
    vectors = (mean.inv() * turns).as_rotvec()
    # the direction of the largest variance first
    directions = np.linalg.eigh(vectors.T @ vectors)[1].T[::-1]
    if np.abs(vectors @ directions[1:].T).max() < AXIS_TOLERANCE:
        # a constant rotation, for example of retargeting, precedes the hinge
        return "hinge", directions[:2], mean.as_quat(scalar_first=True)
    axes, stray = fit_two_axes(turns.as_matrix())
    return ("universal", axes, still) if stray < AXIS_TOLERANCE else ("ball", np.eye(3)[:2], still)


def fit_two_axes(matrices: Float[np.ndarray, "F 3 3"]) -> tuple[Float[np.ndarray, "2 3"], float]:
    """Fit the axes of `R = Rot(a, s) Rot(b, t)` at right angles; return also the largest deviation, radians.

    Such rotations have `a . R b = 0`, which is linear in `a b^T`, and no other matrix is orthogonal to all
    of them. The axes are the two factors of the matrix with the least residual over the samples.
    """
    flat = matrices.reshape(len(matrices), 9)
    least = np.linalg.eigh(flat.T @ flat)[1][:, 0].reshape(3, 3)
    left, _, right = np.linalg.svd(least)
    a, b = left[:, 0], right[0]
    stray = float(np.abs(np.einsum("a,fab,b->f", a, matrices, b)).max())
    # with noise the axes are not exactly orthogonal
    b = b - (a @ b) * a
    return np.stack([a, b / np.linalg.norm(b)]), stray


def _middle_angle(angles: Float[np.ndarray, "F"], joint: str) -> float:
    """Compute the middle of a range on the circle: opposite to its widest gap."""
    ordered = np.sort(angles)
    gaps = np.diff(np.append(ordered, ordered[0] + 2 * np.pi))
    widest = int(np.argmax(gaps))
    if 2 * np.pi - gaps[widest] > 2 * MAX_ANGLE:
        raise FullTurnError(joint, 2 * np.pi - gaps[widest])
    start = ordered[(widest + 1) % len(ordered)]
    middle = start + (2 * np.pi - gaps[widest]) / 2
    return float((middle + np.pi) % (2 * np.pi) - np.pi)


def _rotation(quaternions: Float[np.ndarray, "*shape 4"]) -> Rotation:
    return Rotation.from_quat(quaternions, scalar_first=True)


def _quaternion_about(axis: Float[np.ndarray, "3"], angle: float) -> Float[np.ndarray, "4"]:
    return np.append(np.cos(angle / 2), np.sin(angle / 2) * axis)


def _angle(rotations: Float[np.ndarray, "F 4"], middle: Float[np.ndarray, "4"]) -> Float[np.ndarray, "F"]:
    return 2 * np.arccos(np.clip(np.abs(rotations @ middle), 0.0, 1.0))
