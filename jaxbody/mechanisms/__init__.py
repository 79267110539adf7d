"""Closed loops: assembled configurations, driven positions, curves of suspensions over travel
and steering."""
