"""Files: other programs, damage."""
