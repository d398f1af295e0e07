"""The embedded human, and people like it."""
