"""Models: bodies, supports, joints and elements by name, stored as arrays; paths to
every number."""
