"""Fourier movement primitives (FMP) for Drake.

Layers, each importing only from the ones before it:

- `fmp_drake.primitives` learns and plays rhythmic skills (NumPy, SciPy,
  scikit-learn; no Drake);
- `fmp_drake.systems` wraps them as Drake systems;
- `fmp_drake.station` wires the whiteboard-wiping Panda;
- `fmp_drake.runs`, `fmp_drake.plots` and `fmp_drake.film` measure, draw and film
  runs of it;
- `fmp_drake.experiments` repeats the paper's section V;
- `fmp_drake.apps` is the command line.

The method is Kulak, Silvério and Calinon, "Fourier movement primitives: an
approach for learning rhythmic robot skills from demonstrations", RSS 2020.
"""

__version__ = "0.1.0"
