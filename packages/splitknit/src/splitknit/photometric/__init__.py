"""Photometric stereo: normals and albedo from images under several lights."""
