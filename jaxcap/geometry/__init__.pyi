"""Geometry on arrays: rotations, meshes, cameras and linear equations."""

from . import dualquat as dualquat
from . import rotation as rotation
from .camera import Camera as Camera
from .camera import look_at as look_at
from .camera import ring_of_cameras as ring_of_cameras
from .camera import unproject as unproject
from .mesh import sample_surface as sample_surface
