"""What acts on a model from outside, as functions of time: motions, signals, roads, loads."""
