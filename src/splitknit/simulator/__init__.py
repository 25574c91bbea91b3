"""The digital twin: fingers, skin, lights and sensor. Shares no code with the inverse stages."""
