"""Limits of joints: ranges, boxes and implicit surfaces."""
