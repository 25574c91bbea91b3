"""splitknit: photographs under one light after another in, a metric surface out.

What stands in ``__init__.pyi`` may be imported, and is imported when it is first used, so that
``import splitknit`` is quick.

>>> import splitknit
>>> result = splitknit.reconstruct(splitknit.read_capture("demo/capture"))  # doctest: +SKIP
>>> result.height_mm.shape  # doctest: +SKIP
(2200, 3200)
"""

from __future__ import annotations

from splitknit.exports import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
