"""What the stations are put together from."""
