"""Observations of sensors: point clouds, depth images, mesh sequences and optical markers."""

from .clouds import Scan as Scan
from .clouds import missing_cloud as missing_cloud
from .clouds import stack_clouds as stack_clouds
from .clouds import thin_cloud as thin_cloud
from .depth_views import DepthView as DepthView
