"""One verb over many inputs, on the workers of a cluster."""
