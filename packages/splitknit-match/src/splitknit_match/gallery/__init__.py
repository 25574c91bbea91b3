"""Galleries: enrolled fingers in one file, encrypted if a key is given."""

KEY_VARIABLE, NEW_KEY_VARIABLE = "SPLITKNIT_GALLERY_KEY", "SPLITKNIT_GALLERY_NEW_KEY"
COUNTER = ".counter"
"""End of the name of the counter file that may lie beside a key file."""
LOG = ".log"
"""End of the name of the access log that may lie beside a gallery."""
