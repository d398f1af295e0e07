"""`jaxcap track`: the run and its folder of results."""
