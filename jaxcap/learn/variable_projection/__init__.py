"""Joint optimisation of all unknowns of a body with linear blend skinning, by variable projection."""
