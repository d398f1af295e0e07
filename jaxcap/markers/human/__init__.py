"""A person from labelled markers: the embedded human as the template of a calibration."""
