"""`jaxcap adapt`: the input, the run and the results of an adaptation."""
