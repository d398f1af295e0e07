"""The embedded human, and people with its topology."""
