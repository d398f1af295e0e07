"""Generalised coordinates: numbers, such as joint angles, that move a skeleton through functions."""
