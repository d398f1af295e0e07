"""`jaxcap edit`: edits of existing motions, one file per verb."""
