"""Planning and building a rig: its dimensions, its parts, its circuit."""
