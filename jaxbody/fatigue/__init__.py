"""Peaks of random responses, level crossings, and fatigue damage from densities and records."""
