"""Drake systems around `fmp_drake.primitives`, one LeafSystem per file."""
