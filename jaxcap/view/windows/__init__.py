"""Windows in a browser, and the server that opens them."""
