"""Trained networks: their files and cards, and the one module that runs onnxruntime."""
