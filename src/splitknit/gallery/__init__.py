"""Galleries: enrolled fingers in one file, encrypted if a key is given."""
