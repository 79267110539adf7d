"""Joints of every kind: slides and turns about one line, several together or in series; the base
class is in `models`."""
