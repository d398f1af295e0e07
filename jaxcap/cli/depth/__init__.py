"""Depth images as the command line names them, for `track`, `info` and `view`."""
