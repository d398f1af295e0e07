"""Skinned, animated bodies as USD."""
