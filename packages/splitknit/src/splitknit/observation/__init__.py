"""From what files hold to linear light: no package behind this one knows encodings, exposures,
black levels, ambient images, flat fields, films, or where photographs lie.

A stored value v becomes (decode(v) - decode(black)) / exposure, less the ambient light treated the
same way. Values are relative to the full scale of the file (255 or 65535), so an unscaled image
lies in [0, 1].
"""
