"""Joint limits learned from motion: samples, voxels, keyframes, and projection of motions."""

from ..body.joint_limits.abstract_limits import AbstractLimits as AbstractLimits
from ..body.joint_limits.abstract_limits import AllLimits as AllLimits
from ..body.joint_limits.abstract_limits import allowed as allowed
from ..body.joint_limits.euler_boxes import EulerBox as EulerBox
from ..body.joint_limits.euler_boxes import EulerBoxes as EulerBoxes
from ..body.joint_limits.euler_boxes import make_euler_boxes as make_euler_boxes
from ..body.joint_limits.implicit_surface import LimitSurface as LimitSurface
from ..body.joint_limits.implicit_surface import SurfaceLimits as SurfaceLimits
from ..body.joint_limits.implicit_surface import comfort as comfort
from ..body.joint_limits.ranges_and_cones import Cone as Cone
from ..body.joint_limits.ranges_and_cones import JointRanges as JointRanges
from ..body.joint_limits.ranges_and_cones import make_joint_ranges as make_joint_ranges
from ..body.joint_limits.rotation_vector_boxes import PoseBoxes as PoseBoxes
from ..body.joint_limits.rotation_vector_boxes import make_pose_boxes as make_pose_boxes
from .boxes import learn_boxes as learn_boxes
from .compare import compare_samples as compare_samples
from .frame_evaluation import allowed_frames as allowed_frames
from .frame_evaluation import comfort_frames as comfort_frames
from .frame_evaluation import nearest_frames as nearest_frames
from .frame_evaluation import residual_frames as residual_frames
from .learn import learn_limits as learn_limits
from .marker_frames import arm_samples as arm_samples
from .motion_projection import project_motion as project_motion
from .samples import gather_samples as gather_samples
