"""Learn how likely poses are: Gaussian mixtures of successive joints."""
