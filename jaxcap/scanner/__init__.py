"""Simulated depth cameras around a moving surface, with noisy and partial clouds and meshes."""
