"""Operating-system services for files: atomic writes, locks, paths, and readers in separate processes."""
