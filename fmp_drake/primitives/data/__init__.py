"""Recorded demonstrations: files, windows, channels, orientations."""
