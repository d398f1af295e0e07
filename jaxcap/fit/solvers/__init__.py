"""Least-squares solvers on manifolds."""
