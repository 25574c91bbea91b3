"""Pixels, the rays through them, and the light on surfaces."""
