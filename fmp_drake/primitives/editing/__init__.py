"""What may be done to a learned skill."""
