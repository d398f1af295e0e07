"""`jaxcap live`: frames as they arrive."""
