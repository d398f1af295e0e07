"""Errors a user can mend."""


class InputError(ValueError):
    """Something the user gave is wrong; the message is one sentence that says what was
    found, where, and what to do. The command line prints it alone and exits with 2."""
