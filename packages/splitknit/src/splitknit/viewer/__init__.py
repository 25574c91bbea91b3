"""The viewer: a page on this machine, and the small server behind it.

``catalogue`` lists what there is to show, ``surface`` and ``marks`` answer the page's requests about a result, ``pair``
about two, ``photographs`` about those without a result; ``service`` answers an address, ``server`` speaks HTTP and
authorises requests. The page is in ``static``.
"""
