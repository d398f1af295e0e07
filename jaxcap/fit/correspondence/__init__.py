"""Which part of a body belongs to which point of a scan."""
