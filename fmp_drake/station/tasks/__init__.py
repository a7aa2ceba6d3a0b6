"""Tasks: the surroundings of a robot, and the measurements of its work."""
