"""Fit bodies: least-squares problems, correspondence, tracking."""
