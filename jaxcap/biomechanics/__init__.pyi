"""Joint angles between anatomical axes, as biomechanics reports them."""

from .anatomical_frames import AnatomicalFrames as AnatomicalFrames
from .anatomical_frames import find_anatomical_frames as find_anatomical_frames
from .angles import JointAngles as JointAngles
from .angles import pose_angles as pose_angles
from .conventions import AngleConvention as AngleConvention
from .conventions import angle_conventions as angle_conventions
