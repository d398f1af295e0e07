"""`jaxcap edit`: what is done with motions that are there, one file a verb."""
