"""A person's anatomy as the start of learning, and the evidence of the meshes for its joints."""
