"""Geometry on arrays: rotations, meshes, cameras and linear equations."""

from . import dual_quaternions as dual_quaternions
from . import rotation as rotation
from .attachment import Attachment as Attachment
from .attachment import attach_points as attach_points
from .attachment import attached_positions as attached_positions
from .camera import Camera as Camera
from .camera import look_at as look_at
from .camera import ring_of_cameras as ring_of_cameras
from .camera import unproject as unproject
from .lens import Lens as Lens
from .lens import distort as distort
from .mesh import sample_surface as sample_surface
