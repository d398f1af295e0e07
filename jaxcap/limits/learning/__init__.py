"""Learning of joint limits from recorded motions: samples, charts, voxels, and primitives matched between shapes."""
