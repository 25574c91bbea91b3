"""How well scores tell fingers apart: rates, confidence intervals, identification, protocols."""
