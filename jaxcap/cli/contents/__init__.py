"""What `jaxcap info` says of each kind of content."""
