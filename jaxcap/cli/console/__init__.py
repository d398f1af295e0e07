"""The output of the command line, its verbs and their options."""
