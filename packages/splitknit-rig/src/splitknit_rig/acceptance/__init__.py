"""The acceptance test of a rig: what a card, a phantom, a ball and a finger show, one row per
question."""
