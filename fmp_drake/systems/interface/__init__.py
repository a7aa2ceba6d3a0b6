"""Helpers for Drake's systems: callbacks, caches, and the model of an arm."""
