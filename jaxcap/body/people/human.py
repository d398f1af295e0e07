"""The embedded human: one mesh and one rig, with morph targets for the shapes of people."""

import functools
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from ...arguments import checked
from ...assets import asset_path
from ...geometry import rotation
from ...geometry.attachment import Attachment, attached_positions
from ...stacking import device_array
from ..body import Body
from ..decimate import reduce_body
from ..skeleton import Skeleton, make_skeleton
from ..skin import LinearSkin
from ..skin.interpolate import interpolate_weights
from .morph_targets import AGES, MorphTargets, Traits, apply_morphs, fit_stature

#: intermediate joints that never move in CMU's motions
FIXED_JOINTS = ("LHipJoint", "RHipJoint")
#: joints too small for a scan of a whole body to show
SMALL_JOINTS = (
    "LThumb", "LeftFingerBase", "LeftHandFinger1", "RThumb", "RightFingerBase", "RightHandFinger1",
)  # fmt: skip
RESOLUTIONS = ("full", "medium", "low")


class _HumanAsset(NamedTuple):
    """The content of `assets/human.npz` (written by scripts/build_human.py)."""

    names: list[str]
    parents: list[int]
    morphs: MorphTargets
    #: the triangles, the skinning weights and, where reduced, the attachment to the full mesh
    surfaces: dict[str, tuple[np.ndarray, np.ndarray, Attachment | None]]


@functools.lru_cache(maxsize=1)
def _load() -> _HumanAsset:
    with np.load(asset_path("human.npz"), allow_pickle=False) as file:
        weights = file["weights"].astype(float)
        weights /= weights.sum(axis=1, keepdims=True)
        surfaces: dict[str, tuple[np.ndarray, np.ndarray, Attachment | None]] = {
            "full": (file["faces"].astype(np.int32), weights, None)
        }
        for name in RESOLUTIONS[1:]:
            hold = Attachment(
                file[f"{name}_corners"].astype(np.int32),
                file[f"{name}_shares"].astype(float),
                file[f"{name}_heights"].astype(float),
            )
            carried = interpolate_weights(weights, hold.corners, hold.barycentric)
            surfaces[name] = file[f"{name}_faces"].astype(np.int32), carried, hold
        return _HumanAsset(
            file["names"].tolist(),
            file["parents"].tolist(),
            MorphTargets(*(file[field] for field in MorphTargets._fields)),
            surfaces,
        )


@checked
def human(
    *,
    sex: Literal["female", "male"] | float | int = "male",
    age: float | int = 25,
    weight: float | int = 0.5,
    muscle: float | int = 0.5,
    height: float | int | None = None,
    resolution: Literal["full", "medium", "low"] | int = "full",
    joints: Literal["full", "tracking"] = "full",
) -> Body:
    """Create a human body with the 31 joints of the CMU motion capture database.

    The body is MakeHuman's (CC0; `assets/README.md`): closed, with linear blend skinning, in metres. Y is
    up; the person looks along +z with the left side towards +x, in an A-pose with slightly bent elbows. The
    origin is MakeHuman's: all soles are at y = -0.82 (to 2 mm), so people share one floor.

    **Arguments:**

    - `sex`: "female", "male" or a mixture from 0 (female) to 1 (male).
    - `age`: years, from 10 to 90.
    - `weight`, `muscle`: from 0 (least) over 0.5 (average) to 1 (most).
    - `height`: standing height in metres, reached by MakeHuman's own height targets, so that trunk and
      limbs change as in people and the joints stay inside. Where it is not given it follows from sex and
      age (1.75 m for a man of 25, 1.61 m for a woman).
    - `resolution`: "full" (13,380 vertices), "medium" (5,000), "low" (1,500), or a number of vertices.
      People of one named resolution share their triangles, so their vertices correspond; a number decimates
      this very person (`reduce_body`).
    - `joints`: "full" makes every joint a ball joint except the two that carry the hips, which do not move
      in CMU's motions and are fixed; "tracking" also fixes fingers and thumbs, which a scan of a whole body
      does not show.

    The root, `Hips`, is free. The x axis of a joint's own frame lies along its bone; its y axis is the axis
    of flexion, and `axes[j]` are its y and z.

    **Raises:** `InputError` with one sentence for an option out of its range, `FileNotFoundError` where the
    asset is missing.
    """
    traits = _make_traits(sex, age, weight, muscle)
    if height is not None:
        traits = fit_stature(_load().morphs, traits, float(height))
    return human_from_traits(traits, resolution, joints)


def human_from_traits(traits: Traits, resolution: str | int = "full", joints: str = "full") -> Body:
    """Create the embedded human with given traits, which are within their ranges; see `human`."""
    if isinstance(resolution, str) and resolution not in RESOLUTIONS:
        raise ValueError(
            f"The resolution '{resolution}' is unknown; give 'full', 'medium', 'low' or a number of vertices."
        )
    if joints not in ("full", "tracking"):
        raise ValueError(f"The set of joints '{joints}' is unknown; give 'full' or 'tracking'.")
    asset, named = _load(), resolution if isinstance(resolution, str) else "full"
    vertices, ends = shape_from_traits(traits, named)
    faces, weights, _ = asset.surfaces[named]
    skeleton, skin = _human_skeleton(asset, ends, joints), LinearSkin(device_array(weights))
    body = Body(skeleton, skin, device_array(vertices), device_array(faces))
    return body if isinstance(resolution, str) else reduce_body(body, resolution)


def shape_from_traits(
    traits: Traits, resolution: str = "full"
) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "J 2 3"]]:
    """Compute vertices of a named resolution and both ends of the bones at rest, metres, from traits."""
    asset = _load()
    vertices, ends = apply_morphs(asset.morphs, traits)
    hold = asset.surfaces[resolution][2]
    return (vertices if hold is None else attached_positions(hold, vertices)), ends


def _make_traits(
    sex: str | float | int, age: float | int, weight: float | int, muscle: float | int
) -> Traits:
    if isinstance(sex, str):
        if sex not in ("female", "male"):
            raise ValueError(f"The sex '{sex}' is unknown; give 'female', 'male' or a number from 0 to 1.")
        sex = float(sex == "male")
    traits = Traits(float(sex), float(age), float(weight), float(muscle))
    ranges = {"sex": (0, 1), "age": (AGES["child"], AGES["old"]), "weight": (0, 1), "muscle": (0, 1)}
    for name, (low, high) in ranges.items():
        value = getattr(traits, name)
        if not low <= value <= high:
            raise ValueError(f"The {name} of a human is {value}; give a number from {low:g} to {high:g}.")
    return traits


def _human_skeleton(asset: _HumanAsset, ends: Float[np.ndarray, "J 2 3"], joints: str) -> Skeleton:
    fixed = FIXED_JOINTS + SMALL_JOINTS if joints == "tracking" else FIXED_JOINTS
    frames = _joint_frames(asset.names, ends)
    return make_skeleton(
        asset.names,
        asset.parents,
        ["free" if name == "Hips" else "fixed" if name in fixed else "ball" for name in asset.names],
        centres=ends[:, 0],
        orientations=rotation.from_matrix(device_array(frames)),
        axes=np.swapaxes(frames, 1, 2)[:, 1:],
    )


def _joint_frames(names: list[str], ends: Float[np.ndarray, "J 2 3"]) -> Float[np.ndarray, "J 3 3"]:
    """Compute rotation matrices with columns along the bone, along the axis of flexion, and the third.

    Arms flex about the normal of the plane in which they are bent, all else about the lateral axis.
    """
    along = dict(zip(names, ends[:, 1] - ends[:, 0], strict=True))
    flexion = dict.fromkeys(names, np.array([1.0, 0.0, 0.0]))
    for side in ("Left", "Right"):
        bend = np.cross(along[f"{side}Arm"], along[f"{side}ForeArm"])
        for part in ("Arm", "ForeArm", "Hand", "FingerBase", "HandFinger1"):
            flexion[f"{side}{part}"] = bend
        flexion[f"{side[0]}Thumb"] = bend
        # these bones lie along the lateral axis, so they flex about the sagittal axis
        flexion[f"{side}Shoulder"] = flexion[f"{side[0]}HipJoint"] = np.array([0.0, 0.0, 1.0])
    x = np.array([along[name] for name in names])
    z = np.cross(x, np.array([flexion[name] for name in names]))
    x, z = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (x, z))
    return np.stack([x, np.cross(z, x), z], axis=2)
