"""Equilibria and their stability, load paths, load cases, preload, rest on a moving base."""
