"""The simulated camera: lens, sensor, and the device that a capture session talks to."""
