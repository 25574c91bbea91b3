"""What people use: the command line, the files it writes, and the report."""
