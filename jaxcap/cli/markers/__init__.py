"""`jaxcap markers`: the verbs of optical markers, one file per verb."""
