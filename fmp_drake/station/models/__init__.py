"""Eraser and whiteboard of any size, and the folder of models."""
