"""`jaxcap prior`: the verbs of pose priors, one file per verb."""
