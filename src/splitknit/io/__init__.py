"""Files in and out: captures, rigs, images, meshes, height maps, prints, and where they came from.

Nothing outside this package and the applications reads or writes a file.
"""
