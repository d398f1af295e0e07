"""Joint limits: ranges, cones, boxes and implicit surfaces; learned from motion; motions projected onto them."""

from .abstract_limits import AbstractLimits as AbstractLimits
from .abstract_limits import AllLimits as AllLimits
from .abstract_limits import allowed as allowed
from .compare import compare_samples as compare_samples
from .euler_boxes import EulerBox as EulerBox
from .euler_boxes import EulerBoxes as EulerBoxes
from .euler_boxes import make_euler_boxes as make_euler_boxes
from .frame_evaluation import allowed_frames as allowed_frames
from .frame_evaluation import comfort_frames as comfort_frames
from .frame_evaluation import nearest_frames as nearest_frames
from .frame_evaluation import residual_frames as residual_frames
from .implicit_surface import LimitSurface as LimitSurface
from .implicit_surface import SurfaceLimits as SurfaceLimits
from .implicit_surface import comfort as comfort
from .learning.boxes import learn_boxes as learn_boxes
from .learning.learn_limits import learn_limits as learn_limits
from .learning.marker_frames import arm_samples as arm_samples
from .learning.samples import gather_samples as gather_samples
from .motion_projection import project_motion as project_motion
from .ranges_and_cones import Cone as Cone
from .ranges_and_cones import JointRanges as JointRanges
from .ranges_and_cones import make_joint_ranges as make_joint_ranges
from .rotation_vector_boxes import PoseBoxes as PoseBoxes
from .rotation_vector_boxes import make_pose_boxes as make_pose_boxes
