"""Simulated fingers with known truth: captures, populations, photographs of a calibration bench.
What stands in ``__init__.pyi`` may be imported.

>>> import splitknit_simulator
>>> capture, truth = splitknit_simulator.simulate_capture(1, settings={"scale": 0.12})
>>> sorted(capture.bands)
['nir', 'white']
"""

from splitknit.exports import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
