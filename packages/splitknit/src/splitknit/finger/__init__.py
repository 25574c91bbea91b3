"""From linear images to the pixels that are the finger: mask, orientation, phalange, contrast,
quality, motion."""
