"""One body's motion for another: by joints, by surfaces of the same mesh, and by points that are to meet."""
