"""Skeletons, motions and joint limits in files."""
