"""The page of a station: scene, lights and camera."""
