"""Joint angles between anatomical axes, as biomechanics reports them."""

from .anatomical_frames import AnatomicalFrames as AnatomicalFrames
from .anatomical_frames import find_anatomical_frames as find_anatomical_frames
from .anatomical_joints import find_anatomical_joints as find_anatomical_joints
from .angle_samples import gather_angle_samples as gather_angle_samples
from .angles import JointAngles as JointAngles
from .angles import pose_angles as pose_angles
from .conventions import AngleConvention as AngleConvention
from .conventions import angle_conventions as angle_conventions
from .person_samples import gather_person_samples as gather_person_samples
