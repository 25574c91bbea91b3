"""How well scores separate genuine from impostor pairs: rates, confidence intervals,
identification, protocols."""
