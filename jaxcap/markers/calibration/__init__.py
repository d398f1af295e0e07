"""Joint estimation of all poses, joint centres and marker positions."""
