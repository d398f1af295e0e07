"""A window in which a body is posed by hand."""
