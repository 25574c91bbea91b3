"""Direct and global light: measured by patterns of high frequency, or estimated by the thesis's
network (`direct`).

Shifted checkerboards (by maximum and minimum, or by known states) after Nayar et al. 2006 and the
thesis's section 3.2.5, whose other methods are in ``validation/separation``. What "direct" means
depends on the pattern's size: light that leaves the skin within a check of where it entered still
counts as direct.
"""
