"""Our own file formats: arrays that are checked and never pickled."""
