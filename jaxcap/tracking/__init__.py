"""Tracking of a body through clouds by expectation maximisation."""
