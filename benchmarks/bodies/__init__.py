"""Body models: forward maps, and parameters fitted to meshes and scans."""
