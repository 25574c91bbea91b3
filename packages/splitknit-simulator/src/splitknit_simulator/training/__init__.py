"""Training of the three networks: direct light, relief and shape. torch is used here alone, and imported lazily."""
