"""The poses of an actor in scans, by themselves, in windows and without an order."""
