"""Direct and global light: measured by patterns (:mod:`splitknit.separation.patterns`), or estimated from one
photograph by the thesis's network (:mod:`splitknit.separation.direct`)."""
