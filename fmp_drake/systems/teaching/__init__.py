"""How a person's hand moves, and what a mouse on a page may do to an arm."""
