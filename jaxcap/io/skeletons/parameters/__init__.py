"""Parameters of SMPL's family: names and shapes of arrays, joints, doubts."""
