"""Measuring a rig: its camera, its lights, its sensor."""
