"""Segmentation of a moving surface into rigid parts."""
