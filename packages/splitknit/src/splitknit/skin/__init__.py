"""Skin: scattering and specular light, and how the `metric` method undoes both, by analysis and
synthesis.

A current surface predicts what photometric stereo would find on it behind the skin's blur; the
difference from what it did find corrects the surface. First the shape on a coarse grid, from all
bands; then the ridges on a fine grid, from the white band; and again, because ridges bias the shape
(the mean normal of a ridged slope is flatter than the slope).
"""
