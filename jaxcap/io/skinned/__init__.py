"""What formats of skinned, animated bodies share."""
