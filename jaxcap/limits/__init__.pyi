"""Joint limits learned from motion: samples, voxels, keyframes, and projection of motions."""

from ..body.limits.euler_boxes import EulerBox as EulerBox
from ..body.limits.euler_boxes import EulerBoxes as EulerBoxes
from ..body.limits.euler_boxes import make_euler_boxes as make_euler_boxes
from ..body.limits.limit_surface import LimitSurface as LimitSurface
from ..body.limits.limit_surface import SurfaceLimits as SurfaceLimits
from ..body.limits.limit_surface import comfort as comfort
from ..body.limits.limits import AbstractLimits as AbstractLimits
from ..body.limits.limits import AllLimits as AllLimits
from ..body.limits.limits import Cone as Cone
from ..body.limits.limits import JointRanges as JointRanges
from ..body.limits.limits import allowed as allowed
from ..body.limits.limits import make_joint_ranges as make_joint_ranges
from ..body.limits.rotation_vector_boxes import PoseBoxes as PoseBoxes
from ..body.limits.rotation_vector_boxes import make_pose_boxes as make_pose_boxes
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
