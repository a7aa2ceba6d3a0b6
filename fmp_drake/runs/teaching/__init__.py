"""Sessions of teaching, and their page."""
