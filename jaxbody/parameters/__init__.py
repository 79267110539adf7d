"""Which numbers may move, and how: ties, transforms, spaces; shared by fit and tune."""
