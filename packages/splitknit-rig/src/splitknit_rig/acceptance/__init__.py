"""The acceptance test of a rig: what a card, a ball and a finger show, one question a row."""
