"""What the command line says, its verbs and their options."""
