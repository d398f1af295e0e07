"""From raw optical markers to a skeleton and its motion."""
