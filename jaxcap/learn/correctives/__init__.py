"""Pose-dependent displacements of a learned body, linear in the rotations of nearby joints."""
