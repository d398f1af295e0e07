"""Figures of a window: bodies, skeletons, points, light."""
