"""Exchange of joints: insertion and removal while a body is learned."""
