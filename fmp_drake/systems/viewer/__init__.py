"""Meshes of paths and tubes."""
