"""Ink on a whiteboard, as pure functions and value types."""
