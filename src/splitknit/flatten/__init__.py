"""From the relief of a finger to a flat print."""

from splitknit.flatten.ridges import PrintSettings, relief_print

__all__ = ["PrintSettings", "relief_print"]
