"""Joint limits learned from motion: samples, voxels, keyframes, and projection of motions."""
