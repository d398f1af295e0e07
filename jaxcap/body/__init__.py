"""Skeletons, poses, skins and bodies."""
