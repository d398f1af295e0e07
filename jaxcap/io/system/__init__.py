"""Files as the operating system has them: whole, locked, named, and read in processes of their own."""
