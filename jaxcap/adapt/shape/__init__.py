"""The shape of an actor: size, proportions, vertices, and what is known of them beforehand."""
