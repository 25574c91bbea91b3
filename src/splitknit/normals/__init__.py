"""Photometric stereo: normals and albedo from images under several lights."""

from splitknit.normals.hanrahan_krueger import SkinFit, hanrahan_krueger, hanrahan_krueger_near
from splitknit.normals.hanrahan_krueger_fit import HanrahanKruegerSettings
from splitknit.normals.lambertian import lambertian
from splitknit.normals.levenberg import LevenbergSettings
from splitknit.normals.light_field import light_field, light_vectors_at
from splitknit.normals.near_light import NearLightSettings, near_light, near_light_weights, pseudo_normals
from splitknit.normals.robust import light_weights, robust
from splitknit.normals.skin_layers import SkinLayers
from splitknit.normals.weights import RobustSettings

__all__ = [
    "HanrahanKruegerSettings",
    "LevenbergSettings",
    "NearLightSettings",
    "RobustSettings",
    "SkinFit",
    "SkinLayers",
    "hanrahan_krueger",
    "hanrahan_krueger_near",
    "lambertian",
    "light_field",
    "light_vectors_at",
    "light_weights",
    "near_light",
    "near_light_weights",
    "pseudo_normals",
    "robust",
]
