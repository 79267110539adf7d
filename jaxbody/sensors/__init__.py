"""Sensors: the readings of instruments on bodies, with gain, bias, delay and lag."""
