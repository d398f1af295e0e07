"""Measurements on real input; each is run as `python -m benchmarks.NAME`."""
