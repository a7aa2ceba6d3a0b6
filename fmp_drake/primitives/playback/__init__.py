"""How a skill is played."""
