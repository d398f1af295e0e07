"""Parallel tracking of the chunks of one long sequence."""
