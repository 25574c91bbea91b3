"""What can be wrong with photographs: one question a function, on plain arrays."""
