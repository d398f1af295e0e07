"""`jaxcap prior`: what poses are likely, one file a verb."""
