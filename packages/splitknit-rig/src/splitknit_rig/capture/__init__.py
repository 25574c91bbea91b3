"""Taking pictures: a session of ambient and lit frames with checks, on a Raspberry Pi or on the
digital twin."""
