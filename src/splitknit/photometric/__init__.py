"""Photometric stereo: normals and albedo from images under several lights."""

from splitknit.imaging.light_field import light_field, light_vectors_at
from splitknit.photometric.hanrahan_krueger import SkinFit, hanrahan_krueger, hanrahan_krueger_near
from splitknit.photometric.hanrahan_krueger_fit import HanrahanKruegerSettings, LevenbergSettings
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.near_light import NearLightSettings, near_light, near_light_weights, pseudo_normals
from splitknit.photometric.robust import RobustSettings, light_weights, robust
from splitknit.photometric.skin_layers import SkinLayers

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
