"""What a page shows of a diagram, and its sliders: each module is one LeafSystem."""
