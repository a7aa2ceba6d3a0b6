"""How a person's hand moves."""
