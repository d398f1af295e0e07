"""One body, with a shape space, from the meshes of several people."""
