"""Skinned, animated bodies as glTF 2.0."""
