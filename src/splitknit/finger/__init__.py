"""From linear images to the pixels that are the finger: mask, orientation, phalange, contrast, quality, motion.

Every function takes and returns arrays on the input's pixel grid. Decisions are made on reduced copies; each docstring
gives the scale.
"""
