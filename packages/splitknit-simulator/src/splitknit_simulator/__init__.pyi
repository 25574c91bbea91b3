"""The door: what users may import; all else may change tomorrow."""

from splitknit_simulator.accuracy import compare as compare
from splitknit_simulator.population.folder import simulate_population as simulate_population
from splitknit_simulator.twin import simulate_capture as simulate_capture

__version__: str

__all__ = ["__version__", "compare", "simulate_capture", "simulate_population"]
