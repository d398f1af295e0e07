"""Rigging of meshes with skeletons and skinning weights."""
