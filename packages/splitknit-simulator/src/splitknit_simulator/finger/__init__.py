"""A finger: ridges, print, shape, skin map, deformation, motion and the state of its skin, without
light."""
