"""A device for metric 3D fingerprints: its parts and LED board, calibration, capture and live
heights. What stands in ``__init__.pyi`` may be imported.
"""

from splitknit.exports import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
