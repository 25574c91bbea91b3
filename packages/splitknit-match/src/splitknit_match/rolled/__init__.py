"""Views of one finger, from the front and in mirrors, as one surface around it."""
