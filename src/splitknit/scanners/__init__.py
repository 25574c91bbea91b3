"""Fingers of other scanners."""
