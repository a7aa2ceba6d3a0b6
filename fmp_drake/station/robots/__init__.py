"""Robots: their models, and the drivers between a robot and its controller."""
