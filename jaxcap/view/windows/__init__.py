"""Windows in a browser, and their server."""
