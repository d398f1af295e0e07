"""The window to pose a body by hand."""
