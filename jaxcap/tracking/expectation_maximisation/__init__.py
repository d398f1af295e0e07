"""The steps of expectation maximisation: posteriors of parts, the update of a pose, densities of a cloud."""
