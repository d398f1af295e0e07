"""Simulated depth cameras around a moving surface, with noisy and partial clouds and meshes."""

from .rooms import make_room as make_room
from .scan import scan_frame as scan_frame
from .scan import scan_scene as scan_scene
from .sensors import SENSORS as SENSORS
from .settings import Scanner as Scanner
