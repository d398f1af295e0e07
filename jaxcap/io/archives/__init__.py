"""Our own files: arrays that are checked and never pickled."""
