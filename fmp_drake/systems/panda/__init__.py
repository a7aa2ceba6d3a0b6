"""Messages of a real Panda, checked in both directions: pure functions."""
