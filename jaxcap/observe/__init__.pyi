"""Observations of sensors: point clouds, depth images, mesh sequences and optical markers."""

from .clouds import Scan as Scan
from .clouds import missing_cloud as missing_cloud
from .clouds import stack_clouds as stack_clouds
from .clouds import thin_cloud as thin_cloud
from .depth_views import DepthView as DepthView
from .floor import find_floor as find_floor
from .floor import is_floor_of as is_floor_of
from .floors_and_walls import find_room as find_room
from .floors_and_walls import remove_planes as remove_planes
from .planes import Plane as Plane
from .planes import find_planes as find_planes
from .planes import refine_plane as refine_plane
