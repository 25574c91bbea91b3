"""The viewer: a page on this machine, and the small server behind it.

``catalogue`` lists what there is to show, ``surface`` and ``measure`` answer the page's requests about a result,
``pair`` about two, ``photographs`` about those without a result,
``service`` answers an address, ``guard`` authorises requests, ``server`` speaks HTTP. The page is in ``static``.
"""
