"""Covariances of fitted body models, from the residuals of their fits."""
