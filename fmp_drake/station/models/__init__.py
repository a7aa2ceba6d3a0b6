"""Writers of URDF and SDF, and the packages of models."""
