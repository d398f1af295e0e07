"""Simulated depth cameras around a moving surface: noisy, partial clouds and meshes as real ones give."""
