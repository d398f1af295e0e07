"""Joints that come and go."""
