"""The viewer: a page on this machine, and the small server behind it.

``catalogue`` lists what there is to show, ``surface`` and ``measure`` answer what the page asks about a result,
``service`` answers an address, ``server`` authorises requests and speaks HTTP. The page is in ``static``.
"""
