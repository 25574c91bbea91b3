"""Direct and global light: measured by patterns of high frequency, or estimated by the thesis's network (`direct`).

Methods for the same two images, after Nayar et al. 2006 and the thesis's section 3.2.5: shifted checkerboards (by
maximum and minimum, by known states, or by their symmetry), phase-shifted sinusoids, a moving occluder, and one image
at a lower resolution. What "direct" means depends on the pattern's size: light that leaves the skin within a check of
where it entered still counts as direct.
"""
