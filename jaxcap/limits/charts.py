"""The chart that fits what a joint did: how many angles, about which axes, from which middle."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ..body.limits.chart import Chart
from .samples import JointSamples

#: a joint has fewer angles than three where rotations stray by less than this, radians
STRAY = np.radians(1.0)
#: no rotation may be further than this from the middle, radians: half a turn away they wrap
FURTHEST = np.radians(170.0)
#: steps to the middle of a range
STEPS = 300


def find_chart(samples: JointSamples) -> Chart:
    """One angle, two or a quaternion, by the joint's kind or, of joints that may turn freely, by what
    they did; centred on the middle of it.

    **Raises:** `ValueError` where rotations reach half a turn from every middle.
    """
    kinds = {"revolute": "hinge", "universal": "universal"}
    kind, axes, base = kinds.get(samples.kind, "ball"), samples.axes, np.array([1.0, 0.0, 0.0, 0.0])
    if kind == "ball":
        kind, axes, base = _angles(samples.rotations)
    if kind == "ball":
        middle = middle_rotation(samples.rotations)
        furthest = _angle(samples.rotations, middle).max()
        if furthest > FURTHEST:
            raise ValueError(_wraps(samples.joint, 2 * furthest))
        return Chart(jnp.asarray(middle), jnp.asarray(axes), "ball")
    raw = Chart(jnp.asarray(base), jnp.asarray(axes), "hinge" if kind == "hinge" else "universal")
    angles = 2 * chart_places(raw, samples.rotations)
    middles = [_middle_angle(angles[:, i], samples.joint) for i in range(raw.dimension)]
    middle = _rotation(base) * _rotation(_about(axes[0], middles[0]))
    if kind == "universal":
        # the second axis turns with the first angle, so the first middle stands before both, and the
        # second one moves into the axis of the first
        second = _rotation(_about(axes[1], middles[1]))
        middle, axes = middle * second, np.stack([second.inv().apply(axes[0]), axes[1]])
    return Chart(jnp.asarray(middle.as_quat(scalar_first=True)), jnp.asarray(axes), raw.kind)


def chart_places(chart: Chart, rotations: Float[np.ndarray, "F 4"]) -> Float[np.ndarray, "F 3"]:
    """The places of rotations in a chart, in double precision where JAX has it."""
    return np.asarray(_places(chart, jnp.asarray(rotations)), float)


@jax.jit
def _places(chart: Chart, rotations):
    return jax.vmap(chart.coordinates)(rotations)


def middle_rotation(rotations: Float[np.ndarray, "F 4"]) -> Float[np.ndarray, "4"]:
    """The rotation whose furthest sample is nearest: steps towards the furthest one that grow
    shorter (Badoiu and Clarkson 2003), from the mean."""
    middle = _rotation(rotations).mean().as_quat(scalar_first=True)
    for step in range(2, STEPS):
        cosines = rotations @ middle
        furthest = int(np.argmin(np.abs(cosines)))
        towards = rotations[furthest] * (1.0 if cosines[furthest] >= 0 else -1.0)
        middle = middle + (towards - middle) / step
        middle /= np.linalg.norm(middle)
    return middle


def _angles(rotations: Float[np.ndarray, "F 4"]) -> tuple[str, np.ndarray, np.ndarray]:
    """How many angles a joint uses that could turn freely, their axes, and the rotation that they start from."""
    turns, still = _rotation(rotations), np.array([1.0, 0.0, 0.0, 0.0])
    mean = turns.mean()
    vectors = (mean.inv() * turns).as_rotvec()
    # the direction of most motion first
    directions = np.linalg.eigh(vectors.T @ vectors)[1].T[::-1]
    if np.abs(vectors @ directions[1:].T).max() < STRAY:
        # what a joint is turned by at all times, as by retargeting, stands before the hinge
        return "hinge", directions[:2], mean.as_quat(scalar_first=True)
    axes, stray = two_axes(turns.as_matrix())
    return ("universal", axes, still) if stray < STRAY else ("ball", np.eye(3)[:2], still)


def two_axes(matrices: Float[np.ndarray, "F 3 3"]) -> tuple[Float[np.ndarray, "2 3"], float]:
    """The axes of `R = Rot(a, s) Rot(b, t)` at right angles, and how far rotations stray from it, radians.

    Such rotations leave `a . R b = 0`, which is linear in `a b^T`, and no other matrix is across all of
    them: the axes are the two factors of the one that samples deny least.
    """
    flat = matrices.reshape(len(matrices), 9)
    least = np.linalg.eigh(flat.T @ flat)[1][:, 0].reshape(3, 3)
    left, _, right = np.linalg.svd(least)
    a, b = left[:, 0], right[0]
    stray = float(np.abs(np.einsum("a,fab,b->f", a, matrices, b)).max())
    # noise leaves the axes a little off their right angle
    b = b - (a @ b) * a
    return np.stack([a, b / np.linalg.norm(b)]), stray


def _middle_angle(angles: Float[np.ndarray, "F"], joint: str) -> float:
    """The middle of a range on the circle: opposite to its widest gap."""
    ordered = np.sort(angles)
    gaps = np.diff(np.append(ordered, ordered[0] + 2 * np.pi))
    widest = int(np.argmax(gaps))
    if 2 * np.pi - gaps[widest] > 2 * FURTHEST:
        raise ValueError(_wraps(joint, 2 * np.pi - gaps[widest]))
    start = ordered[(widest + 1) % len(ordered)]
    middle = start + (2 * np.pi - gaps[widest]) / 2
    return float((middle + np.pi) % (2 * np.pi) - np.pi)


def _wraps(joint: str, span: float) -> str:
    return (
        f"Joint '{joint}' turns through {np.degrees(span):.0f} degrees, so that no middle keeps its range within "
        "half a turn; its rotations wrap, and limits cannot be learned from them."
    )


def _rotation(quaternions: Float[np.ndarray, "*shape 4"]) -> Rotation:
    return Rotation.from_quat(quaternions, scalar_first=True)


def _about(axis: Float[np.ndarray, "3"], angle: float) -> Float[np.ndarray, "4"]:
    return np.append(np.cos(angle / 2), np.sin(angle / 2) * axis)


def _angle(rotations: Float[np.ndarray, "F 4"], middle: Float[np.ndarray, "4"]) -> Float[np.ndarray, "F"]:
    return 2 * np.arccos(np.clip(np.abs(rotations @ middle), 0.0, 1.0))
