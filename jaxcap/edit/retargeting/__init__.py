"""Retarget motions between bodies: by joints, by surfaces of the same mesh, and by corresponding points."""
