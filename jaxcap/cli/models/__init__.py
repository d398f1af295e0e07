"""Bodies and body models that arguments name without a file."""
