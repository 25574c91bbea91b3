"""The steps of :mod:`splitknit.pipeline`: which stages a preset calls, with which images."""
