"""Models: bodies, supports, joints and elements by name, as arrays; laws, inputs; paths."""
