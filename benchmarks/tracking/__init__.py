"""Tracking and first poses."""
