"""Where the seconds go."""
