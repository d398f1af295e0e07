"""Simulated depth cameras around a moving surface, with noisy and partial clouds and meshes."""

from .scan import scan_frame as scan_frame
from .settings import Scanner as Scanner
