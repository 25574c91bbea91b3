"""The door: what users (``__all__``) and the other members may import; all else may change tomorrow."""

from splitknit_simulator.bench_photos import BOARD as BOARD
from splitknit_simulator.calibration_set.flat import BoardScene as BoardScene
from splitknit_simulator.calibration_set.flat import CardScene as CardScene
from splitknit_simulator.calibration_set.flat import DiscScene as DiscScene
from splitknit_simulator.calibration_set.flat import board_poses as board_poses
from splitknit_simulator.calibration_set.solids import NailScene as NailScene
from splitknit_simulator.calibration_set.solids import SphereScene as SphereScene
from splitknit_simulator.calibration_set.solids import unit as unit
from splitknit_simulator.camera.device import Clock as Clock
from splitknit_simulator.camera.device import LitScene as LitScene
from splitknit_simulator.camera.device import TwinCamera as TwinCamera
from splitknit_simulator.camera.device import TwinDeviceSettings as TwinDeviceSettings
from splitknit_simulator.camera.device import TwinLightBank as TwinLightBank
from splitknit_simulator.camera.sensor import SensorSettings as SensorSettings
from splitknit_simulator.finger.finger import PoseRanges as PoseRanges
from splitknit_simulator.finger.finger import draw_finger as draw_finger
from splitknit_simulator.finger.finger import finger_surface as finger_surface
from splitknit_simulator.light.films import fresnel_amplitudes as fresnel_amplitudes
from splitknit_simulator.light.films import reflected_through as reflected_through
from splitknit_simulator.light.films import side_lights as side_lights
from splitknit_simulator.light.films import turned_film_rad as turned_film_rad
from splitknit_simulator.light.lighting import irradiance as irradiance
from splitknit_simulator.light.renderer import RenderSettings as RenderSettings
from splitknit_simulator.population.folder import simulate_population as simulate_population
from splitknit_simulator.scene import TwinSettings as TwinSettings
from splitknit_simulator.twin import FingerScene as FingerScene
from splitknit_simulator.twin import simulate_capture as simulate_capture
from splitknit_simulator.twin import twin_settings as twin_settings

__version__: str

__all__ = ["__version__", "simulate_capture", "simulate_population"]
