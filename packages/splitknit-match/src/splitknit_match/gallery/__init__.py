"""Galleries: enrolled fingers in one SQLite file, encrypted by SQLCipher if a key is given."""
