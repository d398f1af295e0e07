"""Joint limits: ranges, boxes and implicit surfaces."""
