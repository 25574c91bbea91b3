"""Galleries: enrolled fingers in one file, encrypted if a key is given."""

from splitknit.gallery.gallery import Enrolled, Gallery, NewCapture

__all__ = ["Enrolled", "Gallery", "NewCapture"]
