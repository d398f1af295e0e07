"""Geometry on arrays: rotations, meshes, cameras and linear equations."""
