"""Discrete movements, from a start to a goal."""
