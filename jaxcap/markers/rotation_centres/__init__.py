"""Centres and axes of rotation between two segments."""
