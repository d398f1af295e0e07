"""The joints between rigid parts, where they are, and poses that follow."""
