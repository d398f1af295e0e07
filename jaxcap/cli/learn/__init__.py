"""`jaxcap learn`: the input, the run and the results of learning a body."""
