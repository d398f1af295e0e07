"""`jaxcap limits`: the verbs of joint limits, one file per verb."""
