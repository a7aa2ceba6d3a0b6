"""What goes to a real Panda and what comes from it: pure functions."""
