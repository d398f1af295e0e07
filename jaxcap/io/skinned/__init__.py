"""Shared parts of the formats of skinned, animated bodies."""
