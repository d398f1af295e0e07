"""Bodies for programs and files that blend linearly and know no other skin."""
