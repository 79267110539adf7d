"""Model files: text to checked SI numbers without JAX, and to models and back."""
