"""Many people with ten fingers each, and captures of them in several sessions."""
