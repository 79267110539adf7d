"""Inputs of a model as functions of time: motions of supports, signals, roads, loads."""
