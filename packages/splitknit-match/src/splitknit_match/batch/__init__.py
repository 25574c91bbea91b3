"""A whole population, reconstructed and compared: resumable, by several processes or a cluster,
into one store."""
