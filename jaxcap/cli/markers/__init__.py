"""`jaxcap markers`: what is done with optical markers, one file a verb."""
