"""Tracking of several people in the same clouds."""
