"""Edited motions."""
