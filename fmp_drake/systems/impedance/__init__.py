"""The impedance law and its safety, as pure functions and value types."""
