"""Messages of a real Panda, checked in both directions, and the gate for its torque."""
