"""Tracking of what arrives: the newest frame is tracked, and older ones are dropped."""

from .live_tracker import LiveTracker as LiveTracker
from .live_tracker import make_live_tracker as make_live_tracker
from .statistics import LiveFrame as LiveFrame
from .statistics import LiveStatistics as LiveStatistics
