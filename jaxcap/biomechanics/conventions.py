"""The conventions of joint angles: segments, order of rotations, axis, sign and source of each angle.

Segments have axes X forward, Y up or towards the trunk, and Z to the right, in the anatomical position. Angles of
the left side are those of the mirror image, so that flexion, adduction and internal rotation have the same sign on
both sides.

- Wu 2002: G. Wu et al., ISB recommendation on definitions of joint coordinate system of various joints for the
  reporting of human joint motion, part I: ankle, hip, and spine. J. Biomech. 35 (2002) 543-548.
- Wu 2005: part II: shoulder, elbow, wrist and hand. J. Biomech. 38 (2005) 981-992.
- Grood and Suntay 1983: A joint coordinate system for the clinical description of three-dimensional motions:
  application to the knee. J. Biomech. Eng. 105 (1983) 136-144.
- Baker 2001: R. Baker, Pelvic angles: a mathematically rigorous definition which is consistent with a conventional
  clinical understanding of the terms. Gait & Posture 13 (2001) 1-6.
"""

from collections.abc import Collection
from typing import Literal, NamedTuple

from ..arguments import checked

Order = Literal["zxy", "yxz", "yxy"]
#: name of the surroundings among the segments
WORLD = "world"


class AngleConvention(NamedTuple):
    """An angle of a joint: a rotation of the distal segment relative to the proximal segment."""

    #: in the manner of OpenSim, such as `hip_flexion_r`
    name: str
    #: segments, such as `pelvis` and `femur_r`
    proximal: str
    distal: str
    #: intrinsic rotations, from the proximal to the distal segment
    order: Order
    #: position of the angle in the order
    position: int
    #: factor of the right-handed rotation about the axis
    sign: int
    #: axis and positive direction, in words
    axis: str
    positive: str
    source: str

    @property
    def mirrored(self) -> bool:
        """True for angles of the left side, which are those of the mirror image."""
        return self.name.endswith("_l")


class _Joint(NamedTuple):
    proximal: str
    distal: str
    order: Order
    source: str
    #: name, sign and positive direction of each angle
    angles: tuple[tuple[str, int, str], ...]
    #: whether there is one on each side
    sided: bool = True


_JOINTS = (
    _Joint(
        WORLD, "pelvis", "yxz", "Baker 2001",
        (
            ("pelvis_rotation", 1, "to the left"),
            ("pelvis_list", 1, "right side down"),
            ("pelvis_tilt", 1, "posterior: the front rises"),
        ),
        sided=False,
    ),
    _Joint(
        "pelvis", "femur", "zxy", "Wu 2002, hip",
        (("hip_flexion", 1, "flexion"), ("hip_adduction", 1, "adduction"), ("hip_rotation", 1, "internal rotation")),
    ),
    _Joint(
        "femur", "tibia", "zxy", "Grood and Suntay 1983",
        (("knee_angle", -1, "flexion"), ("knee_adduction", 1, "adduction (varus)"), ("knee_rotation", 1, "internal rotation")),
    ),
    _Joint(
        "tibia", "foot", "zxy", "Wu 2002, ankle",
        (("ankle_angle", 1, "dorsiflexion"), ("ankle_inversion", 1, "inversion"), ("ankle_rotation", 1, "internal rotation")),
    ),
    _Joint(
        "pelvis", "thorax", "zxy", "Wu 2002, spine",
        (
            ("lumbar_extension", 1, "extension (backward)"),
            ("lumbar_bending", 1, "to the right"),
            ("lumbar_rotation", 1, "to the left"),
        ),
        sided=False,
    ),
    _Joint(
        "thorax", "head", "zxy", "Wu 2002, spine",
        (("neck_extension", 1, "extension (backward)"), ("neck_bending", 1, "to the right"), ("neck_rotation", 1, "to the left")),
        sided=False,
    ),
    _Joint(
        "thorax", "humerus", "yxy", "Wu 2005, 2.4.7",
        (
            ("elv_angle", 1, "to the front; 0 is abduction, 90 is forward flexion"),
            ("shoulder_elv", -1, "elevation; 0 is an arm along the trunk"),
            ("shoulder_rot", 1, "internal rotation"),
        ),
    ),
    _Joint(
        "thorax", "humerus", "zxy", "alternative order, as Wu 2002, hip",
        (("arm_flex", 1, "flexion"), ("arm_add", 1, "adduction"), ("arm_rot", 1, "internal rotation")),
    ),
    _Joint(
        "humerus", "forearm", "zxy", "Wu 2005, 3.4.1",
        (
            ("elbow_flex", 1, "flexion"),
            ("elbow_carrying", -1, "valgus: the hand away from the trunk"),
            ("pro_sup", 1, "pronation; 0 is full supination"),
        ),
    ),
    _Joint(
        "forearm", "hand", "zxy", "Wu 2005, 4.4.1",
        (("wrist_flex", 1, "flexion"), ("wrist_dev", 1, "ulnar deviation"), ("wrist_rot", 1, "pronation")),
    ),
)  # fmt: skip
#: axes of a joint coordinate system by the order of rotations
_AXES: dict[Order, tuple[str, str, str]] = {
    "zxy": ("Z of the {0}", "floating axis X", "Y of the {1}"),
    "yxz": ("Y of the {0} (vertical)", "floating axis X", "Z of the {1}"),
    "yxy": ("Y of the {0}", "X of the {1} before its axial rotation", "Y of the {1}"),
}
MIDLINE = (WORLD, "pelvis", "thorax", "head")
SEGMENTS = ("pelvis", "thorax", "head") + tuple(
    f"{segment}_{side}" for side in "rl" for segment in ("femur", "tibia", "foot", "humerus", "forearm", "hand")
)  # fmt: skip


@checked
def angle_conventions(segments: Collection[str] = SEGMENTS) -> tuple[AngleConvention, ...]:
    """List the angles between segments, in the order of their columns; by default, all angles."""
    there = {WORLD, *segments}
    return tuple(
        convention
        for sided, sides in ((False, ("",)), (True, ("_r", "_l")))
        for side in sides
        for joint in _JOINTS
        if joint.sided is sided
        for convention in _angles(joint, side)
        if convention.proximal in there and convention.distal in there
    )


def _angles(joint: _Joint, side: str) -> list[AngleConvention]:
    proximal, distal = (
        segment if segment in MIDLINE else segment + side for segment in (joint.proximal, joint.distal)
    )
    axes = [axis.format(joint.proximal, joint.distal) for axis in _AXES[joint.order]]
    return [
        AngleConvention(name + side, proximal, distal, joint.order, place, sign, axis, positive, joint.source)
        for place, ((name, sign, positive), axis) in enumerate(zip(joint.angles, axes, strict=True))
    ]
