"""Closed loops: assembled configurations, driven positions, curves; ready cars and models."""
