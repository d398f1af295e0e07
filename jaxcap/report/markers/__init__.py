"""Reports of subjects and markers."""
