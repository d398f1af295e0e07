"""Fits of body models beyond one shape: coefficients that change from mesh to mesh, and covariances."""
