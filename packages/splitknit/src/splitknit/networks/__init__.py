"""Trained networks: the one module that reads and runs them, and test-time augmentation."""
