"""Depth images and live tracking."""
