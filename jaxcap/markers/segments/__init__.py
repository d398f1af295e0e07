"""Sets of markers that move as one, and where they are in every frame."""
