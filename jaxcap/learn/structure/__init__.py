"""Insertion and removal of joints."""
