"""Many frames and what they share as one least-squares problem."""
