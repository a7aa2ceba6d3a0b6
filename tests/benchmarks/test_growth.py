"""Growth of time and memory with the sizes of a skill."""

import matplotlib as mpl
import numpy as np
from benchmarks.fresh_process import learn

mpl.use("Agg")
from matplotlib import pyplot as plt

BASE = {"T": 200, "D": 3, "N": 1000, "M": 10}
GRID = {
    "T": (100, 200, 400, 800),
    "D": (1, 3, 6, 12),
    "N": (500, 1000, 2000, 4000),
    "M": (5, 10, 20, 40),
}
WHAT = {
    "fit_s": "fit (s)",
    "fit_mb": "memory of the fit (MB)",
    "map_us": "mapping (us)",
}
NAMES = {
    "T": "T, samples in a window",
    "D": "D, channels",
    "N": "N, windows",
    "M": "M, components",
}


def measure():
    """Return the figures of every size of the grid, each in a fresh process."""
    base = learn(*BASE.values())
    return {
        name: [
            base if size == BASE[name] else learn(*{**BASE, name: size}.values())
            for size in sizes
        ]
        for name, sizes in GRID.items()
    }


def draw(found, exponents, path):
    figure, axes = plt.subplots(
        len(WHAT), len(GRID), figsize=(11, 7.5), sharey="row", layout="constrained"
    )
    for row, (key, label) in zip(axes, WHAT.items(), strict=True):
        row[0].set_ylabel(label)
        for axis, (name, sizes) in zip(row, GRID.items(), strict=True):
            axis.loglog(sizes, [f[key] for f in found[name]], "o-", base=2)
            axis.set_title(f"exponent {exponents[name, key]:.2f}", fontsize=9)
            axis.set_xticks(sizes, [str(size) for size in sizes])
            axis.minorticks_off()
            axis.yaxis.set_major_formatter("{x:g}")
            axis.grid(alpha=0.3)
    for axis, name in zip(axes[-1], GRID, strict=True):
        axis.set_xlabel(NAMES[name])
    base = ", ".join(f"{name} = {size}" for name, size in BASE.items())
    figure.suptitle(f"Growth with each size, the others at {base}; K = 10")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def test_growth(benchmark, figures, out):
    found = benchmark.pedantic(measure, rounds=1)
    exponents = {
        (name, key): float(
            np.polyfit(np.log(sizes), np.log([f[key] for f in found[name]]), 1)[0]
        )
        for name, sizes in GRID.items()
        for key in WHAT
    }
    draw(found, exponents, out / "growth.png")
    base = ", ".join(f"{name} = {size}" for name, size in BASE.items())
    figures.section = f"Growth around {base}: fitted exponents (out/growth.png)"
    for name, sizes in GRID.items():
        for key, label in WHAT.items():
            ends = f"{found[name][0][key]:.3g} to {found[name][-1][key]:.3g}"
            figures.add(
                f"{label} with {name} = {sizes[0]} to {sizes[-1]}: {ends}, exponent",
                exponents[name, key],
                digits=2,
            )
    benchmark.extra_info["grid"] = found
