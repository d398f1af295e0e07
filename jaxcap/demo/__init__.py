"""A small performance, scanned and tracked."""
