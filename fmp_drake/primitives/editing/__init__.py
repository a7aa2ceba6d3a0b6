"""Changes of a learned skill: tempo, place, size, harmonics, orientation."""
