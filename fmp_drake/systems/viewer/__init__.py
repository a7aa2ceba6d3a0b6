"""Meshes of paths and tubes, and the panel of the page."""
