"""The wiping station: Panda, eraser and whiteboard, wired for simulation."""
