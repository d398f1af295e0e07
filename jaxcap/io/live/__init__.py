"""Frames that arrive while a program runs: growing folders, pipes, depth cameras."""
