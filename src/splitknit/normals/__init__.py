"""Photometric stereo: normals and albedo from images under several lights."""

from splitknit.normals.lambertian import lambertian
from splitknit.normals.light_field import light_field, light_vectors_at
from splitknit.normals.near_light import NearLightSettings, near_light, near_light_weights, pseudo_normals
from splitknit.normals.robust import light_weights, robust
from splitknit.normals.weights import RobustSettings

__all__ = [
    "NearLightSettings",
    "RobustSettings",
    "lambertian",
    "light_field",
    "light_vectors_at",
    "light_weights",
    "near_light",
    "near_light_weights",
    "pseudo_normals",
    "robust",
]
