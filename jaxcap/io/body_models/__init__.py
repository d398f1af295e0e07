"""Readers of body models: the files of SMPL's family."""
