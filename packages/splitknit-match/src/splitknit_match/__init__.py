"""Whose finger it is: prints, matching, galleries, records of other systems, error rates. What
stands in ``__init__.pyi`` may be imported.
"""

from splitknit.exports import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
