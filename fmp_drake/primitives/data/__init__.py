"""What comes in: demonstrations, windows, files."""
