"""The joints of SKEL (Keller et al. 2023): their axes, their counterparts in SMPL, and how shoulders and spine slide."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation


class SkelJoint(NamedTuple):
    """A joint of SKEL."""

    name: str
    #: axes of its angles in the axes of the OpenSim model, with signs; the first angle rotates first
    axes: tuple[tuple[float, float, float], ...]
    #: the joint of SMPL whose pose-dependent displacements follow it; 0 for none
    smpl: int


def _pin(orientation: tuple[float, float, float]) -> tuple[tuple[float, float, float], ...]:
    """Return the z axis of a frame that is rotated about x, then its own y, then its own z."""
    return (tuple(Rotation.from_euler("XYZ", orientation).apply([0.0, 0.0, 1.0]).tolist()),)


_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_BACK_X, _BACK_Y, _BACK_Z = (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)
_TALUS = _pin((0.175895, -0.105208, 0.0186622))
_SPINE = (_X, _Z, _Y)
#: the joints in their order
JOINTS = (
    SkelJoint("pelvis", (_Z, _X, _Y), 0),
    SkelJoint("femur_r", (_Z, _X, _Y), 2),
    SkelJoint("tibia_r", (_BACK_Z,), 5),
    # the ankle's two joints have one counterpart, which follows the second
    SkelJoint("talus_r", _TALUS, 0),
    SkelJoint("calcn_r", _pin((-1.76818999, 0.906223, 1.8196)), 8),
    SkelJoint("toes_r", _pin((-3.141589999, 0.619901, 0.0)), 11),
    SkelJoint("femur_l", (_Z, _BACK_X, _BACK_Y), 1),
    SkelJoint("tibia_l", (_BACK_Z,), 4),
    SkelJoint("talus_l", _TALUS, 0),
    SkelJoint("calcn_l", _pin((1.768189999, -0.906223, 1.8196)), 7),
    SkelJoint("toes_l", _pin((-3.141589999, -0.619901, 0.0)), 10),
    SkelJoint("lumbar_body", _SPINE, 3),
    SkelJoint("thorax", _SPINE, 6),
    SkelJoint("head", _SPINE, 15),
    SkelJoint("scapula_r", (_Y, _BACK_Z, _BACK_X), 14),
    SkelJoint("humerus_r", (_X, _Y, _Z), 17),
    SkelJoint("ulna_r", ((0.0494, 0.0366, 0.99810825),), 19),
    SkelJoint("radius_r", ((-0.01716099, 0.99266564, -0.11966796),), 0),
    SkelJoint("hand_r", (_X, _BACK_Z), 21),
    SkelJoint("scapula_l", (_Y, _Z, _X), 13),
    SkelJoint("humerus_l", (_X, _Y, _Z), 16),
    SkelJoint("ulna_l", ((-0.0494, -0.0366, 0.99810825),), 18),
    SkelJoint("radius_l", ((0.01716099, -0.99266564, -0.11966796),), 0),
    SkelJoint("hand_l", (_BACK_X, _BACK_Z), 20),
)
NAMES = tuple(joint.name for joint in JOINTS)
#: first angle of each joint, and the number of all angles
FIRST_ANGLES = np.cumsum([0, *(len(joint.axes) for joint in JOINTS)])
NUM_ANGLES = int(FIRST_ANGLES[-1])
#: bones whose orientation does not depend on the shape
_FIXED = ("pelvis", "toes_r", "toes_l", "head", "hand_r", "hand_l")


def bone_frames(
    parents: list[int],
    centres: Float[np.ndarray, "J 3"],
    learned: Float[np.ndarray, "J 3 3"],
    offsets: Float[np.ndarray, "J 3"],
) -> Float[np.ndarray, "J 3 3"]:
    """Compute the orientations of the bones of a shape: those that were `learned`, and the least rotation that aligns each bone
    from its place in the OpenSim model, at `offsets` from its parent, to its joints at rest.
    """
    count = len(parents)
    steps = centres - np.where(np.arange(count)[:, None] > 0, centres[np.maximum(parents, 0)], 0.0)
    child = [next((k for k in range(count) if parents[k] == joint), 0) for joint in range(count)]
    along, before = steps[child], offsets[child]
    for ulna, radius in (
        (NAMES.index("ulna_r"), NAMES.index("radius_r")),
        (NAMES.index("ulna_l"), NAMES.index("radius_l")),
    ):
        # from the elbow to the wrist
        along[ulna] = along[ulna] + along[radius]
        before[ulna] = before[ulna] + before[radius]
    along[NAMES.index("thorax")] = along[NAMES.index("lumbar_body")]
    turns = np.tile(np.eye(3), (count, 1, 1))
    for joint in range(count):
        if NAMES[joint] not in _FIXED:
            turns[joint] = _align(learned[joint] @ before[joint], along[joint])
    return turns @ learned


def _align(a: Float[np.ndarray, "3"], b: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Compute the rotation of least angle that aligns a direction with another; zero, as SKEL has it, where one has no length."""
    lengths = np.linalg.norm(a) * np.linalg.norm(b)
    if lengths == 0:
        return np.zeros((3, 3))
    x, y, z = np.cross(a, b) / lengths
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + across + across @ across / max(1.0 + a @ b / lengths, 1e-12)


def joint_shifts(
    angles: Float[np.ndarray, "F A"], centres: Float[np.ndarray, "J 3"]
) -> Float[np.ndarray, "F J 3"]:
    """Compute how far the joints slide in their parents: shoulder blades along an ellipsoid, the spine along arcs of its length."""
    shifts = np.zeros((len(angles), len(JOINTS), 3))
    blades = [centres[NAMES.index(name)] for name in ("scapula_l", "scapula_r")]
    thorax, lumbar = centres[NAMES.index("thorax")], centres[NAMES.index("lumbar_body")]
    width = float(np.linalg.norm(blades[0] - blades[1]))
    height = float(np.linalg.norm(thorax - lumbar))
    for name, sign in (("scapula_r", 1.0), ("scapula_l", -1.0)):
        joint = NAMES.index(name)
        first = FIRST_ANGLES[joint]
        moved = _on_ellipsoid(sign * angles[:, first], sign * angles[:, first + 1], sign, width, height)
        none = np.zeros(1)
        shifts[:, joint] = moved - _on_ellipsoid(none, none, sign, width, height)
    for name, below in (("lumbar_body", "pelvis"), ("thorax", "lumbar_body"), ("head", "thorax")):
        joint = NAMES.index(name)
        length = abs(centres[joint, 1] - centres[NAMES.index(below), 1])
        (x, up), (z, up_z) = (_arc(angles[:, FIRST_ANGLES[joint] + k], length) for k in range(2))
        shifts[:, joint] = np.stack([-x, up + up_z, -z], 1)
    return shifts


def _on_ellipsoid(abduction, elevation, sign: float, width: float, height: float) -> Float[np.ndarray, "F 3"]:
    raised = elevation - np.pi / 4
    across = width / 4 * np.cos(raised)
    return np.stack(
        [
            -sign * across * np.cos(abduction),
            -height / 2 * np.sin(raised),
            width / 4 * np.sin(abduction),
        ],
        1,
    )


def _arc(angle, length: float):
    """Compute the end of an arc of some length that begins upwards: sideways, and how far it is below a straight one, negative."""
    half = np.sinc(angle / (2 * np.pi))
    return length * half * np.sin(angle / 2), length * (np.sinc(angle / np.pi) - 1.0)
