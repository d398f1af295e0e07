"""Adapt a template body to the actor in a sequence of scans."""
