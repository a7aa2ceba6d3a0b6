"""Section V-B: polishing, Figs. 3 to 6."""

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fmp_drake.experiments.baselines.promp import AlignedProMP, ProMP
from fmp_drake.experiments.comparison import (
    FMP_STRIDE,
    N_STEPS,
    PAPER_STRIDE,
    RATE,
    DemonstratedPath,
    cut,
    divergences,
    draw_grids,
    draw_paths,
    grid_extent,
    millimetres,
    play,
)
from fmp_drake.experiments.report import Finding, Profile
from fmp_drake.plots.demonstrations import (
    draw_demonstrations_over_time,
    draw_windows_in_plane,
)
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.primitives.data.windows import joined_recordings

# The paper's polishing has 3 periods in a window of 6 s.
_FREQUENCY = 3.0
_SECONDS = 12.0


def polishing(demonstration: Demonstration, profile: Profile) -> list[Finding]:
    """Run the polishing experiments on a demonstration."""
    recording = demonstration.resample(RATE)
    windows = cut([recording], stride=PAPER_STRIDE)
    path = DemonstratedPath(recording.values)
    # The bases are the paper's cosines.
    aligned = AlignedProMP(model=ProMP(frequencies=(1.0,)))
    aligned.fit(joined_recordings(windows))
    skill = FourierMovementPrimitive(model="mixture", random_state=0)
    skill.fit(cut([recording], stride=FMP_STRIDE))
    low, high = skill.extent_
    inside = recording.values[len(recording.values) // 2]
    outside = (low + high) / 2 + (high - low) * np.array([1.0, 0.75, 0.0])
    return [
        _demonstrations(recording, skill),
        _from_starts(play(skill, [inside, outside], _SECONDS), recording, path),
        _promp_heatmaps(aligned, windows, profile),
        _promp_conditioned(aligned, windows, inside, outside, recording, path),
    ]


def _demonstrations(
    recording: Demonstration, skill: FourierMovementPrimitive
) -> Finding:
    figure = Figure(figsize=(10, 4.5), layout="constrained")
    left, right = np.asarray(figure.subfigures(1, 2), dtype=object)
    first = Demonstration(time=recording.time[:400], values=recording.values[:400])
    draw_demonstrations_over_time(first, left.subplots(3, 1, sharex=True))
    draw_windows_in_plane(skill, [recording], right.subplots())
    return Finding(
        name="fig3",
        title="Fig. 3: demonstrations of polishing",
        shows=f"{recording.duration:.0f} s of guided polishing, the first 20 s over time, "
        f"and windows of {N_STEPS / RATE:g} s in the plane, in the colours of their "
        "components. The windows start at any phase.",
        figure=figure,
    )


def _last_period(paths: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the last 2 s of paths (..., ticks, D)."""
    return paths[..., -round(2 * RATE) :, :]


def _from_starts(
    played: NDArray[np.float64],
    recording: Demonstration,
    demonstrated: DemonstratedPath,
) -> Finding:
    paths = dict(zip(("interpolation", "extrapolation"), played, strict=True))
    distances = demonstrated.distances(_last_period(played)).max(axis=1)
    start_distance = float(demonstrated.distances(played[1, :1])[0])
    return Finding(
        name="fig4",
        title="Fig. 4: polishing from different initial positions with FMP",
        shows=f"From a start {millimetres(start_distance)} outside the demonstrations "
        f"(right) the last 2 s of {_SECONDS:g} s are within {millimetres(distances[1])} of "
        f"them, from inside (left) within {millimetres(distances[0])}.",
        claim="FMP interpolates and extrapolates: the movement returns to the "
        "demonstrated limit cycle.",
        agrees=bool(np.all(distances < 0.01)),
        figure=draw_paths(recording, paths),
    )


def _promp_heatmaps(
    aligned: AlignedProMP, windows: NDArray[np.float64], profile: Profile
) -> Finding:
    extent = grid_extent(windows)
    models = {
        "aligned, one period (5a)": aligned.model_,
        "T = 120, 1 Gaussian (5b)": ProMP(frequencies=(_FREQUENCY,)).fit(windows),
        "T = 120, 10 Gaussians (5c)": ProMP(
            frequencies=(_FREQUENCY,), n_components=10
        ).fit(windows),
    }
    samples = {"demonstrations": windows}
    kl = {}
    for name, model in models.items():
        samples[name] = model.sample(profile.samples, seed=0)
        kl[name] = divergences(samples[name], windows, extent=extent)
    period, one, ten = (forward for forward, _ in kl.values())
    return Finding(
        name="fig5",
        title="Fig. 5: heatmaps of the distribution learned with ProMP-VM",
        shows="Forward KL to the demonstrations: aligned "
        f"{period:.2f}, unaligned with one Gaussian {one:.2f}, unaligned with ten "
        f"{ten:.2f}.",
        claim="ProMP-VM fits aligned periods; without alignment one Gaussian does not, and "
        "a mixture does.",
        agrees=period < 0.5 * one and ten < 0.5 * one,
        figure=draw_grids(samples, extent=extent),
    )


def _promp_conditioned(
    aligned: AlignedProMP,
    windows: NDArray[np.float64],
    inside: NDArray[np.float64],
    outside: NDArray[np.float64],
    recording: Demonstration,
    demonstrated: DemonstratedPath,
) -> Finding:
    mixture = ProMP(frequencies=(_FREQUENCY,), n_components=10).fit(windows)
    # 6a conditions the aligned model on a start at another phase, half a period later.
    period = aligned.model_.condition([0], [inside])
    opposite = period[len(period) // 2]
    paths = {
        "aligned, other phase (6a)": aligned.model_.condition([0], [opposite]),
        "mixture, interpolation (6b)": mixture.condition([0], [inside]),
        "mixture, extrapolation (6c)": mixture.condition([0], [outside]),
    }
    a, b, c = (
        demonstrated.distances(_last_period(path)).max() for path in paths.values()
    )
    return Finding(
        name="fig6",
        title="Fig. 6: conditioning on the initial position with ProMP-VM",
        shows=f"Greatest distance from the demonstrations in the last 2 s: aligned and "
        f"started at another phase {millimetres(a)}, mixture from inside "
        f"{millimetres(b)}, mixture from outside {millimetres(c)}.",
        claim="With alignment the movement cannot start at another phase; a mixture without "
        "alignment adapts inside the demonstrations, but from outside it does not "
        "return to them.",
        agrees=bool(a > 0.02 and b < 0.02 and c > 0.02),
        figure=draw_paths(recording, paths),
    )
