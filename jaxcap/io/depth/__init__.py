"""Depth images, masks, and the intrinsics of their cameras."""
