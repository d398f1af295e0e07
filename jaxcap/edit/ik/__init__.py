"""Inverse kinematics: solve for the pose in which points of a body reach given targets."""
