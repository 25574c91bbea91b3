"""Training of the networks from the command line: data, folders, cards."""
