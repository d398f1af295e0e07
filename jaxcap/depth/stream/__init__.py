"""Clouds of a person in successive depth images of cameras that do not move."""
