"""One long sequence in chunks that are tracked at the same time."""
