"""Left-right symmetry of registered meshes, found on the surface."""
