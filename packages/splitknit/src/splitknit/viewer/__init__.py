"""One result's surface in the browser: ``surface`` is what is shown and cut, ``server`` the page's server."""
