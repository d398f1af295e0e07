"""Skeletons, poses, skins and bodies."""

from .body import Posed as Posed
from .body import posed_vertices as posed_vertices
from .body_model import BodyModel as BodyModel
from .body_model import body_coefficients as body_coefficients
from .body_model import split_coefficients as split_coefficients
from .decimate import reduce_body as reduce_body
from .decimate import reduce_model as reduce_model
from .euler_angles import joint_euler_angles as joint_euler_angles
from .kinematics import Transforms as Transforms
from .people.sample import sample_poses as sample_poses
from .retraction import difference as difference
from .retraction import project as project
from .shape_modes import ShapeModes as ShapeModes
from .skeleton import dof_layout as dof_layout
from .skin import AbstractPoseFeatures as AbstractPoseFeatures
from .skin import AbstractSkin as AbstractSkin
from .skin import CorrectedSkin as CorrectedSkin
from .skin import QuaternionFeatures as QuaternionFeatures
from .skin import RigidSkin as RigidSkin
from .skin import RotationMatrixFeatures as RotationMatrixFeatures
from .skin import swing_twist_from as swing_twist_from
