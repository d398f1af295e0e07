"""The poses of an actor in scans: single frames, windows and unordered scans."""
