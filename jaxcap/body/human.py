"""The embedded human: one mesh, one rig, and as many people as its shape targets give."""

import functools
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..assets import asset_path
from ..geometry import rotation
from .body import Body
from .skeleton import make_skeleton
from .skinning import LinearSkin

#: the age in years at which each target of age has its full share
AGES = {"child": 10.0, "young": 25.0, "old": 90.0}
#: joints that only lead on to the next one and never move in CMU's motions
CARRIERS = ("LHipJoint", "RHipJoint")
#: joints too small for a scan of a whole body to show
TWIGS = tuple(
    side + part for side in ("Left", "Right") for part in ("FingerBase", "HandFinger1")
) + ("LThumb", "RThumb")
#: the shape deltas are stored as whole tenths of a millimetre
STEP = 1e-4


class _Asset(NamedTuple):
    """The arrays of `assets/human.npz`, as written by scripts/build_human.py."""

    vertices: np.ndarray
    faces: np.ndarray
    weights: np.ndarray
    names: np.ndarray
    parents: np.ndarray
    joints: np.ndarray
    target_states: np.ndarray
    target_vertices: np.ndarray
    target_joints: np.ndarray


@functools.lru_cache(maxsize=1)
def _asset() -> _Asset:
    with np.load(asset_path("human.npz"), allow_pickle=False) as arrays:
        return _Asset(*(arrays[name] for name in _Asset._fields))


def human(
    *,
    sex: Literal["female", "male"] | float = "male",
    age: float = 25.0,
    weight: float = 0.5,
    muscle: float = 0.5,
    height: float | None = None,
    joints: Literal["full", "tracking"] = "full",
) -> Body:
    """A human body with the 31 joints of the CMU motion capture database (names as in its BVH files).

    The body is MakeHuman's (CC0; `assets/README.md`): 13,380 vertices and 26,756 triangles, closed,
    in metres. Y is up, the person looks along +z with the left side towards +x, and stands in an
    A-pose with the elbows a little bent. The origin lies near the hips, as in MakeHuman: the soles
    of the default body are at y = -0.82.

    **Arguments:**

    - `sex`: "female", "male" or a mixture from 0 (female) to 1 (male).
    - `age`: years, from 10 to 90.
    - `weight`, `muscle`: from 0 (least) over 0.5 (average) to 1 (most).
    - `height`: standing height in metres, reached by MakeHuman's own height targets, so that limbs
      and trunk grow in proportion and joints stay in place; where it is not given it follows from
      the rest (1.75 m for the default man, 1.60 m for the woman).
    - `joints`: "full" makes every joint a ball joint except the two hip carriers, which are fixed
      as they are in CMU's motions; "tracking" also fixes fingers and thumbs, which a scan of a whole
      body does not show.

    The root, `Hips`, is free. The x axis of a joint's own frame lies along its bone and its y axis
    is the axis of flexion, which is `axes[j, 0]` too.

    **Raises:** `ValueError` with one sentence for an option outside its range.
    """
    if isinstance(sex, str):
        if sex not in ("female", "male"):
            raise ValueError(f"The sex '{sex}' is unknown; give 'female', 'male' or a number from 0 to 1.")
        sex = float(sex == "male")
    for name, value, low, high in (
        ("sex", sex, 0.0, 1.0),
        ("age", age, AGES["child"], AGES["old"]),
        ("weight", weight, 0.0, 1.0),
        ("muscle", muscle, 0.0, 1.0),
    ):
        if not low <= value <= high:
            raise ValueError(f"The {name} of a human is {value}; give a number from {low:g} to {high:g}.")
    if joints not in ("full", "tracking"):
        raise ValueError(f"The set of joints '{joints}' is unknown; give 'full' or 'tracking'.")
    asset = _asset()
    shares = _shares(sex, age, weight, muscle)
    stature = 0.0 if height is None else _solve_stature(shares, height)
    vertices, ends = _shape(_coefficients(shares, stature))
    frames = _joint_frames([str(name) for name in asset.names], ends)
    skeleton = make_skeleton(
        [str(name) for name in asset.names],
        asset.parents.tolist(),
        [_kind(str(name), joints) for name in asset.names],
        centres=ends[:, 0],
        orientations=_quaternions(frames),
        axes=np.swapaxes(frames, 1, 2)[:, 1:],
    )
    return Body(
        skeleton,
        LinearSkin(jnp.asarray(asset.weights, skeleton.centres.dtype)),
        jnp.asarray(vertices),
        jnp.asarray(asset.faces, jnp.int32),
    )


def _shares(sex: float, age: float, weight: float, muscle: float) -> dict[str, float]:
    """How much of each state of a person is present; the states of one trait sum to one."""

    def between(value: float, anchors: dict[str, float]) -> dict[str, float]:
        peaks = np.eye(len(anchors))
        return {
            state: float(np.interp(value, list(anchors.values()), peak))
            for state, peak in zip(anchors, peaks, strict=True)
        }

    def levels(trait: str) -> dict[str, float]:
        return {f"min{trait}": 0.0, f"average{trait}": 0.5, f"max{trait}": 1.0}

    return {
        **between(sex, {"female": 0.0, "male": 1.0}),
        **between(age, AGES),
        **between(weight, levels("weight")),
        **between(muscle, levels("muscle")),
    }


def _coefficients(shares: dict[str, float], stature: float) -> np.ndarray:
    """The weight (T,) of every target: the product of the shares of the states in its name.

    `stature` runs from -1 (MakeHuman's shortest) over 0 (as sex and age have it) to 1 (tallest).
    """
    shares = {**shares, "minheight": max(-stature, 0.0), "maxheight": max(stature, 0.0)}
    return np.array([np.prod([shares[state] for state in str(states).split()]) for states in _asset().target_states])


def _shape(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and the ends of the bones (J, 2, 3) of one person, metres."""
    asset = _asset()
    vertices, ends = asset.vertices.astype(float), asset.joints.astype(float)
    for target in np.flatnonzero(coefficients):
        vertices += coefficients[target] * STEP * asset.target_vertices[target]
        ends += coefficients[target] * asset.target_joints[target]
    return vertices, ends


def _solve_stature(shares: dict[str, float], height: float) -> float:
    """The stature at which the person is `height` metres tall, by bisection to a micrometre."""

    def tall(stature: float) -> float:
        return float(np.ptp(_shape(_coefficients(shares, stature))[0][:, 1]))

    low, high = -1.0, 1.0
    shortest, tallest = tall(low), tall(high)
    if not shortest <= height <= tallest:
        raise ValueError(
            f"The height of a human is {height} m; at this sex, age, weight and muscle it can be "
            f"from {shortest:.2f} to {tallest:.2f} m."
        )
    for _ in range(22):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if tall(middle) < height else (low, middle)
    return 0.5 * (low + high)


def _kind(name: str, joints: str) -> str:
    if name == "Hips":
        return "free"
    fixed = CARRIERS + TWIGS if joints == "tracking" else CARRIERS
    return "fixed" if name in fixed else "ball"


def _joint_frames(names: list[str], ends: np.ndarray) -> np.ndarray:
    """Rotation matrices (J, 3, 3): columns along the bone, along the axis of flexion, and the third.

    Arms flex about the normal of the plane of the bent arm, all else about the lateral axis.
    """
    along = ends[:, 1] - ends[:, 0]
    flexion = np.tile([1.0, 0.0, 0.0], (len(names), 1))
    for side in ("Left", "Right"):
        upper, fore = names.index(f"{side}Arm"), names.index(f"{side}ForeArm")
        hand = [f"{side}{part}" for part in ("Arm", "ForeArm", "Hand", "FingerBase", "HandFinger1")]
        for name in [*hand, f"{side[0]}Thumb"]:
            flexion[names.index(name)] = np.cross(along[upper], along[fore])
        # a clavicle lies along the lateral axis itself, and lifts about the one through the chest
        flexion[names.index(f"{side}Shoulder")] = [0.0, 0.0, 1.0]
    for name in CARRIERS:
        flexion[names.index(name)] = [0.0, 0.0, 1.0]
    x = along / np.linalg.norm(along, axis=1, keepdims=True)
    z = np.cross(x, flexion)
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=2)


def _quaternions(matrices: np.ndarray) -> np.ndarray:
    return np.asarray(rotation.from_matrix(jnp.asarray(matrices)))
