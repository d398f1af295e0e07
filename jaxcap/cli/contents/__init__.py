"""The output of `jaxcap info` for each kind of content."""
