"""Studies in files: a model with motions, loads, sensors, experiments and designs; the schema of
all entries of a file."""
