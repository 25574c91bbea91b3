"""The finger's shape from one image: its outlines in front view and in mirrors beside it."""
