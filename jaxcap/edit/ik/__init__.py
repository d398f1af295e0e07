"""Inverse kinematics: the pose in which points of a body reach given places."""
