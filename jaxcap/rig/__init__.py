"""Put a skeleton into a mesh."""
