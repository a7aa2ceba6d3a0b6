"""Systems that draw a diagram on its page, the sliders, and the panel with its server."""
