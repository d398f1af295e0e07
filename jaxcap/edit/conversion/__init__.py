"""Conversion of shapes and motions from one body to another by their surfaces."""
