"""Skinning weights and rest vertices."""
