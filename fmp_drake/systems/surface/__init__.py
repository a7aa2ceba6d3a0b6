"""Curved surfaces and the motion of a tool over them, as pure functions and value types."""
