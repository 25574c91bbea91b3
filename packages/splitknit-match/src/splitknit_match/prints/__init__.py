"""From a finger in space to a flat print: sampling, unrolling, curvature, ink, enhancement."""
