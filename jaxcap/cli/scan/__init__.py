"""`jaxcap scan`: the run and its folder of scans."""
