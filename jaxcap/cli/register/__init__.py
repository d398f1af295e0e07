"""`jaxcap register`: scans registered to one topology."""
