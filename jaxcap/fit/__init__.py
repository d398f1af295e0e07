"""Fitting of bodies: least-squares problems, correspondence, tracking."""
