"""Rotations, poses and frames; points, directions and orientations as users give them."""
