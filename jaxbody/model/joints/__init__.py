"""Joints of every kind: the base class; slides and turns about one line, several or in series."""
