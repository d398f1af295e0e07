"""Correspondence between points of a scan and parts of a body."""
