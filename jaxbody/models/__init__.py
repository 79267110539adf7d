"""Bodies, supports and joints by name, kept as arrays; paths to every number."""
