"""The shape of an actor: size, proportions, vertices, and their priors."""
