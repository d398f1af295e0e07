"""Track a body through clouds by expectation maximisation."""
