"""People with the marker sets of laboratories: builds, placement, soft tissue, gaps and swaps."""

from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

import jaxcap as jc
from benchmarks._scenes import cmu_motion
from benchmarks.markers._markers import MarkerNoise, corrupt_markers, pose_all
from jaxcap.body.people.human import human_from_traits
from jaxcap.body.people.morph_targets import Traits
from jaxcap.body.pose import rest_pose
from jaxcap.geometry import rotation
from jaxcap.geometry.attachment import Attachment, attach_points, attached_positions
from jaxcap.geometry.mesh import area_normals
from jaxcap.markers.marker_sets.joints_by_landmarks import joints_by_landmarks
from jaxcap.markers.marker_sets.landmarks import landmark_attachment
from jaxcap.markers.marker_sets.recognise import MarkerSet, recognise_markers
from jaxcap.markers.subject import Subject, make_subject
from jaxcap.observe.markers import MarkerFrames


def _sided(labels: str, left: str = "L", right: str = "R") -> list[str]:
    return [label.replace("?", side) for label in labels.split() for side in (left, right)]


#: labels as the laboratories write them; `?` is the side
LABORATORIES: dict[str, list[str]] = {
    "plug_in_gait": ["C7", "T10", "CLAV", "STRN", "RBAK"] + _sided(
        "?FHD ?BHD ?SHO ?UPA ?ELB ?FRM ?WRA ?WRB ?FIN ?ASI ?PSI ?THI ?KNE ?TIB ?ANK ?HEE ?TOE"),
    "cmu": ["C7", "T10", "CLAV", "STRN", "RBAC"] + _sided(
        "?FHD ?BHD ?SHO ?UPA ?ELB ?FRM ?WRA ?WRB ?FIN ?FWT ?BWT ?THI ?KNE ?SHN ?ANK ?HEE ?MT5 ?TOE"),
    "vicon_53": ["ARIEL", "C7", "T10", "CLAV", "STRN", "MFWT", "MBWT"] + _sided(
        "?FHD ?BHD ?FSH ?BSH ?UPA ?ELB ?IEL ?FRM ?OWR ?IWR ?OHAND ?IHAND ?FWT ?BWT ?THI ?KNE ?KNI ?SHN ?ANK ?HEL ?MT1 ?MT5 ?TOE"),
    "conventional_gait_2": ["C7", "T10", "CLAV", "STRN"] + _sided(
        "?FHD ?BHD ?SHO ?UPA ?ELB ?FRM ?WRA ?WRB ?FIN ?ASI ?PSI ?THI ?THAP ?THAD ?KNE ?KNM ?TIB ?TIAP ?TIAD ?ANK ?MED ?HEE "
        "?TOE ?SMH ?FMH ?VMH"),
    "helen_hayes": ["Top.Head", "Front.Head", "Rear.Head", "V.Sacral", "R.Scapula"] + _sided(
        "?.Shoulder ?.Elbow ?.Wrist ?.ASIS ?.Thigh ?.Knee ?.Knee.Medial ?.Shank ?.Ankle ?.Ankle.Medial ?.Heel ?.Toe"),
    "rizzoli_cast": ["CV7", "TV2", "TV7", "LV3", "LV5", "SJN", "SXS", "SGL"] + _sided(
        "?_HEAD ?_SAE ?_HLE ?_HME ?_RSP ?_USP ?_HM2 ?_HM5 ?_IAS ?_IPS ?_FTC ?_FLE ?_FME ?_TH1 ?_TH2 ?_TH3 ?_TH4 ?_FAX ?_TTC "
        "?_SK1 ?_SK2 ?_SK3 ?_SK4 ?_FAL ?_TAM ?_FCC ?_FM1 ?_FM2 ?_FM5"),
    "opensim_rajagopal": ["C7", "CLAV"] + _sided(
        "?ACR ?ASH ?PSH ?LEL ?MEL ?FAradius ?FAulna ?UA1 ?UA2 ?UA3 ?ASI ?PSI ?TH1 ?TH2 ?TH3 ?LFC ?MFC ?TB1 ?TB2 ?TB3 ?LMAL "
        "?MMAL ?CAL ?MT1 ?MT5 ?TOE"),
    "motive": ["HeadTop", "HeadFront", "HeadSide", "BackTop", "Chest", "BackLeft", "BackRight"] + _sided(
        "Waist?Front Waist?Back ?ShoulderTop ?ShoulderBack ?UArmHigh ?ElbowOut ?WristOut ?WristIn ?HandOut ?ThighFront "
        "?KneeOut ?Shin ?AnkleOut ?ToeOut ?ToeIn ?Heel ?ToeTip"),
}  # fmt: skip
TAKES = ("02_01", "02_05", "01_01", "02_03", "01_05", "02_07")

#: metres that skin moves over the bone at the largest angles, and at random (Leardini et al. 2005, Peters et al. 2010)
SOFT_TISSUE = {
    "UpLeg": 0.015,
    "Leg": 0.008,
    "Hips": 0.008,
    "Arm": 0.008,
    "ForeArm": 0.005,
    "Shoulder": 0.008,
    "Spine": 0.005,
}
OTHER_SOFT_TISSUE = 0.003
#: standard deviation of the placement along each tangent of the skin, and across it, metres
PLACING, PLACING_NORMAL = 0.007, 0.002
#: the same of markers that are somewhere on a segment, and on a plate
PLACING_LOOSE = 0.03
#: share of bones' lengths that the person's traits do not have
LENGTH_DEVIATION = 0.03
NOISE = MarkerNoise(noise=0.001, gaps=0.05, burst=15, swaps=0.005)


class Person(NamedTuple):
    """A build with its own lengths of bones."""

    body: jc.Body
    traits: Traits


class LaboratoryScene(NamedTuple):
    """Frames of a laboratory's markers and what is true of them."""

    frames: MarkerFrames
    truth: Subject
    joints: Float[np.ndarray, "F J 3"]
    #: a trial in which the person stands; None if there is none
    static: MarkerFrames | None


def make_person(seed: int, resolution: str = "medium") -> Person:
    """Draw the traits of an adult, and scale single bones, left as right, with their skin.

    Joints of limbs and the neck are relative to the landmarks as those of the man of 25 are, which the joints of
    other traits are not: those of the knees are off by up to 3 cm (`joints_by_landmarks`).
    """
    rng = np.random.default_rng([seed, 1])
    sex = float(seed % 2)
    traits = Traits(
        sex, rng.uniform(18, 75), np.clip(rng.normal(0.5, 0.2), 0, 1), np.clip(rng.normal(0.5, 0.2), 0, 1),
        np.clip(rng.normal(0, 0.15), -1, 1),
    )  # fmt: skip
    body = human_from_traits(Traits(*(float(x) for x in traits)), resolution, "tracking")
    skeleton = body.skeleton
    names = [
        name.replace("Right", "Left").replace("RHip", "LHip").replace("RThumb", "LThumb")
        for name in skeleton.names
    ]
    factors = {name: float(np.exp(LENGTH_DEVIATION * rng.normal())) for name in sorted(set(names))}
    body = centre_joints(body, resolution)
    return Person(scale_bones(body, np.array([factors[name] for name in names])), traits)


def centre_joints(body: jc.Body, resolution: str) -> jc.Body:
    """Place joints relative to the landmarks of the skin, where those of the man of 25 are."""
    centres = joints_by_landmarks(
        np.asarray(body.vertices, float), np.asarray(body.skeleton.centres, float), resolution
    )
    return eqx.tree_at(lambda b: b.skeleton.centres, body, jnp.asarray(centres, body.vertices.dtype))


def scale_bones(body: jc.Body, factors: Float[np.ndarray, "J"]) -> jc.Body:
    """Scale the offset of each joint from its parent, and the skin of the parent's bone along it."""
    skeleton, old = body.skeleton, np.asarray(body.skeleton.centres, float)
    centres, stretch = old.copy(), np.tile(np.eye(3), (len(old), 1, 1))
    longest = np.zeros(len(old))
    for joint, parent in enumerate(skeleton.parents):
        if parent < 0:
            continue
        away = old[joint] - old[parent]
        centres[joint] = centres[parent] + factors[joint] * away
        length = np.linalg.norm(away)
        # the skin of a bone follows its longest offset
        if length > max(longest[parent], 0.03):
            longest[parent] = length
            along = away / length
            stretch[parent] = np.eye(3) + (factors[joint] - 1) * np.outer(along, along)
    weights = np.asarray(body.skin.bone_weights(len(old)), float)
    vertices = np.asarray(body.vertices, float)
    moved = np.einsum("jab,vjb->vja", stretch, vertices[:, None] - old) + centres
    dtype = body.vertices.dtype
    scaled = jnp.asarray(np.einsum("vj,vja->va", weights, moved), dtype), jnp.asarray(centres, dtype)
    return eqx.tree_at(lambda b: (b.vertices, b.skeleton.centres), body, scaled)


def place_markers(person: Person, labels: list[str], seed: int, resolution: str = "medium") -> Subject:
    """Place a laboratory's markers on a person, as its staff would: near the landmarks, never exactly."""
    rng = np.random.default_rng([seed, 2])
    found, (names, hold) = recognise_markers(labels), landmark_attachment(resolution)
    unknown = [label for label, name in zip(labels, found.names, strict=True) if name is None]
    if unknown:
        raise ValueError(
            f"The labels {', '.join(unknown)} are in no marker set; correct the laboratory's list."
        )
    body = person.body
    vertices, faces = np.asarray(body.vertices, float), np.asarray(body.faces)
    rows = [names.index(str(name)) for name in found.names]
    on_skin = Attachment(hold.corners[rows], hold.barycentric[rows], np.zeros(len(rows)))
    loose = found.deviations > 0.025
    spread = np.where(loose, PLACING_LOOSE, PLACING)[:, None]
    aimed = attached_positions(on_skin, vertices) + spread * rng.normal(size=(len(rows), 3))
    hold = attach_points(aimed, vertices, faces)
    flat = Attachment(hold.corners, np.clip(hold.barycentric, 0, 1), np.zeros(len(rows)))
    flat = Attachment(flat.corners, flat.barycentric / flat.barycentric.sum(1, keepdims=True), flat.heights)
    normals = area_normals(vertices[hold.corners])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    heights = found.heights + PLACING_NORMAL * rng.normal(size=len(rows))
    places = attached_positions(flat, vertices) + heights[:, None] * normals
    bones = [body.skeleton.index(str(bone)) for bone in found.bones]
    return make_subject(body.skeleton, bones, places, labels, deviations=np.full(len(rows), 0.01))


def make_laboratory_scene(
    shared: Path, laboratory: str, seed: int, take: str, frames: int, static: bool = False, rate: float = 60.0
) -> LaboratoryScene:
    """Simulate a take of one person in one laboratory, and a static trial of a second where asked for."""
    person = make_person(seed)
    truth = place_markers(person, LABORATORIES[laboratory], seed)
    motion, skeleton = cmu_motion(shared, take)
    motion = motion.slice(slice(None, None, round(motion.rate / rate))).slice(slice(frames))
    motion = jc.retarget(motion, skeleton, truth.skeleton)
    motion = jax.tree.map(lambda leaf: leaf.astype(truth.offsets.dtype), motion)
    standing = round(rate) if static else 0
    motion = _prepend_standing(motion, truth.skeleton, standing)
    rng = np.random.default_rng([seed, 3])
    shifts = soft_tissue(truth, motion, rng)
    places, joints = (np.array(x, float) for x in pose_all(truth, motion.poses, jnp.asarray(shifts)))
    places, seen, _ = corrupt_markers(places, NOISE, rng)
    dtype = truth.offsets.dtype
    both = MarkerFrames(places.astype(dtype), seen, truth.labels, motion.rate)
    trial = both[slice(standing)] if static else None
    return LaboratoryScene(both[slice(standing, None)], truth, joints[standing:], trial)


def soft_tissue(truth: Subject, motion: jc.Motion, rng: np.random.Generator) -> Float[np.ndarray, "F M 3"]:
    """Move markers over their bones with the angles of the joints at both ends, and smoothly at random.

    Half of the largest displacement is from each. Angles are scaled to their range in the take, at least 30 degrees.
    """
    skeleton, bones = truth.skeleton, np.asarray(truth.bones)
    angles = np.linalg.norm(np.asarray(rotation.log(motion.poses.rotations), float), axis=-1)
    angles -= angles.mean(0)
    angles /= np.maximum(np.abs(angles).max(0), np.radians(30.0))
    child = {parent: joint for joint, parent in reversed(list(enumerate(skeleton.parents))) if parent >= 0}
    ends = np.stack([angles[:, bones], angles[:, [child.get(bone, bone) for bone in bones]]], -1)
    sizes = np.array([_tissue_size(skeleton.names[bone]) for bone in bones])
    directions = rng.normal(size=(2, len(bones), 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    driven = 0.5 * np.einsum("fme,ema->fma", ends, directions)
    # about a cycle a second
    wander = gaussian_filter1d(rng.normal(size=driven.shape), 0.2 * motion.rate, axis=0, mode="wrap")
    wander *= 0.25 / np.maximum(wander.std(0), 1e-9)
    return sizes[:, None] * (driven + wander)


def describe_set(laboratory: str) -> MarkerSet:
    """Recognise the labels of a laboratory."""
    return recognise_markers(LABORATORIES[laboratory])


def _tissue_size(bone: str) -> float:
    plain = bone.removeprefix("Left").removeprefix("Right").rstrip("1")
    return SOFT_TISSUE.get(plain, OTHER_SOFT_TISSUE)


def _prepend_standing(motion: jc.Motion, skeleton: jc.Skeleton, count: int) -> jc.Motion:
    """Put standing at rest in front of a motion, at its first place."""
    rest = rest_pose(skeleton)
    still = eqx.tree_at(
        lambda pose: pose.translations, rest, rest.translations.at[0].set(motion.poses.translations[0, 0])
    )
    poses = jax.tree.map(
        lambda one, all_frames: jnp.concatenate([jnp.repeat(jnp.asarray(one)[None], count, 0), all_frames]),
        still,
        motion.poses,
    )
    return eqx.tree_at(lambda m: m.poses, motion, poses)
