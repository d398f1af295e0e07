"""Edit motions: retarget, cut, join, loop, redirect the gaze, and reduce to keys; animate scans; solve
inverse kinematics.

`import jaxcap as jc` makes all of it available as `jc.edit`: `jc.edit.cut(motion, 10, 29)`. `retarget`,
`solve_ik` and their types are also in `jc` itself. Functions that transfer a motion take `(motion, source,
target)`; all others take the skeleton or the body first, and then its motion.
"""

from ..body.people.sample import sample_poses as sample_poses
from .clips import Loop as Loop
from .clips import cut as cut
from .clips import join as join
from .clips import make_loop as make_loop
from .gaze import Gaze as Gaze
from .gaze import look_at_target as look_at_target
from .gaze_line import GazeLine as GazeLine
from .gaze_line import gaze_shares as gaze_shares
from .gaze_line import human_line as human_line
from .gaze_line import line_of_joint as line_of_joint
from .gaze_line import line_of_vertices as line_of_vertices
from .glue import Glue as Glue
from .glue import animate_scan as animate_scan
from .glue import glue_scan as glue_scan
from .glue import glued_points as glued_points
from .ik.constraints import Constraint as Constraint
from .ik.constraints import Constraints as Constraints
from .ik.constraints import make_constraints as make_constraints
from .ik.solve import IkOptions as IkOptions
from .ik.solve import IkSolution as IkSolution
from .ik.solve import solve_ik as solve_ik
from .interpolation import resample as resample
from .keys import Keys as Keys
from .keys import find_keys as find_keys
from .keys import interpolate_keys as interpolate_keys
from .linear.influences import limit_influences as limit_influences
from .linear.linearise import Linearised as Linearised
from .linear.linearise import linear_motion as linear_motion
from .linear.linearise import linear_pose as linear_pose
from .linear.linearise import linearise as linearise
from .matching.match import match_joints as match_joints
from .matching.matches import JointMatches as JointMatches
from .matching.matches import UnmatchedJoints as UnmatchedJoints
from .mirror_motion import mirror as mirror
from .retargeting.plan import RetargetPlan as RetargetPlan
from .retargeting.plan import plan_retarget as plan_retarget
from .retargeting.point_pairs import PointPair as PointPair
from .retargeting.point_pairs import PointPairResult as PointPairResult
from .retargeting.point_pairs import meet_points as meet_points
from .retargeting.retarget import floor_of as floor_of
from .retargeting.retarget import retarget as retarget
from .retargeting.retarget import size_ratio as size_ratio
from .retargeting.retarget import vertical as vertical
from .retargeting.retarget_shape import ShapeRetarget as ShapeRetarget
from .retargeting.retarget_shape import retarget_shape as retarget_shape
from .retargeting.soles import floor_under as floor_under
from .retargeting.soles import ground as ground
from .retargeting.soles import lowest as lowest
from .retargeting.soles import sole_heights as sole_heights
from .transitions import Transition as Transition
from .transitions import find_loops as find_loops
from .transitions import find_transitions as find_transitions
from .transitions import transition_distances as transition_distances
