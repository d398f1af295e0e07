"""Rotations, meshes, cameras and linear equations as arrays."""
