"""Joint limits learned from motion: samples, voxels, keyframes, and motions held to them."""
