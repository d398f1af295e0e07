"""Windows in a browser."""
