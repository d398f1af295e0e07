"""`jaxcap limits`: what is done with joint limits, one file a verb."""
