"""Sets of markers that move rigidly together, and their frames over time."""
