"""Discrete movements."""
