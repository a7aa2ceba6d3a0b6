"""How a system declares itself to Drake."""
