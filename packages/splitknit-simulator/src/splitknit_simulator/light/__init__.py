"""Light on skin: optics, LEDs, coats, rendering, and its separation into direct and global
light."""
