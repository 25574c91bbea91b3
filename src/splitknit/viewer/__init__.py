"""The viewer: a page on this machine, and the small server behind it.

``catalogue`` says what there is to show, ``surface`` reads a result, ``tiles`` and ``measure`` answer what the page
asks about it, ``guard`` decides who may ask, ``handler`` speaks HTTP. The page is in ``static``.
"""
