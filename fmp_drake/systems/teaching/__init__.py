"""Motion of a guiding hand, and of a mouse that drags the arm on the page."""
