"""The motion of a known subject through frames of markers."""
