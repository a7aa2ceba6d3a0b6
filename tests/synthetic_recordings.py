"""Synthetic recordings with known rhythmic and other parts."""

from dataclasses import dataclass

import numpy as np

RATE = 20.0


@dataclass(frozen=True)
class Synthetic:
    """A recording (n, D), the duration of a cycle (s), and the intervals beside the bouts."""

    values: np.ndarray
    period: float
    cycles: float
    left_out: list[tuple[float, float, str]]


def waves(harmonics, magnitudes, phases, t=60):
    """Return one channel: a sum of cosines of a window."""
    n = np.arange(t)[:, None]
    return np.sum(
        np.asarray(magnitudes)
        * np.cos(2 * np.pi * np.asarray(harmonics) * n / t + np.asarray(phases)),
        axis=1,
    )


def random_curve(rng, channels):
    """Return a function from phases (n,) to points (n, D) of a curve about 0.1 m wide."""
    harmonics = int(rng.integers(1, 4))
    sizes = 0.1 * 2.5 ** -np.arange(harmonics)
    angles = rng.uniform(0, 2 * np.pi, (harmonics, 2))
    plane = np.linalg.qr(rng.standard_normal((channels, 2)))[0]
    orders = np.arange(1, harmonics + 1)
    widths = rng.uniform([1.0, 0.4], [1.0, 1.0], (harmonics, 2)) * sizes[:, None]
    angles[0, 1] = angles[0, 0] + np.pi / 2 * rng.choice([-1, 1])

    def curve(phase):
        waves = np.cos(np.asarray(phase)[:, None, None] * orders[:, None] + angles)
        return (waves * widths).sum(axis=1) @ plane.T

    return curve


def eased(start, end, count):
    """Return a straight path that begins and ends at rest, without its ends."""
    t = np.linspace(0, 1, count + 2)[1:-1, None]
    return start + (end - start) * t**3 * (10 - 15 * t + 6 * t**2)


def varying_phase(rng, count, period, spread):
    """Return unwrapped phases (n,) whose velocity varies slowly by a relative spread."""
    width = max(3, round(period))
    noise = rng.standard_normal(count + 2 * width)
    slow = np.convolve(noise, np.hanning(width) / np.linalg.norm(np.hanning(width)))
    velocity = 2 * np.pi / period * (1 + spread * slow[width : width + count])
    return rng.uniform(0, 2 * np.pi) + np.cumsum(np.maximum(velocity, 0.3 / period))


def smooth_noise(rng, count, channels, size):
    noise = rng.standard_normal((count + 8, channels))
    smooth = np.stack([np.convolve(n, np.ones(9) / 3, "valid") for n in noise.T], 1)
    return size * smooth


def synthetic_recording(seed):
    """Draw a recording with an approach, a retreat, bouts, lifts and pauses, or without."""
    rng = np.random.default_rng(seed)
    channels = int(rng.integers(2, 4))
    curve = random_curve(rng, channels)
    period = rng.uniform(1.2, 5.0) * RATE
    spread = rng.uniform(0.0, 0.1)
    bouts = int(rng.choice([1, 1, 2, 3]))
    pieces, left_out, cycles, moved = [], [], 0.0, 0.0

    def add(path, kind=None):
        if kind is not None:
            start = sum(map(len, pieces)) / RATE
            left_out.append((start, start + len(path) / RATE, kind))
        pieces.append(path)

    def away(distance):
        direction = rng.standard_normal(channels)
        return distance * direction / np.linalg.norm(direction)

    for bout in range(bouts):
        count = round(rng.uniform(3.0, 7.0) * period)
        phase = varying_phase(rng, count, period, spread)
        if bout:
            phase += rng.uniform(0, 2 * np.pi)
        path = curve(phase)
        if bout == 0 and rng.random() < 0.6:
            begin = path[0] + away(rng.uniform(0.25, 0.5))
            add(eased(begin, path[0], round(rng.uniform(1.0, 3.0) * RATE)), "approach")
        if bout:
            top = pieces[-1][-1] + away(rng.uniform(0.15, 0.3))
            up = eased(pieces[-1][-1], top, round(rng.uniform(0.7, 1.5) * RATE))
            down = eased(top, path[0], round(rng.uniform(0.7, 1.5) * RATE))
            add(np.concatenate([up, down]), "lift")
        if rng.random() < 0.25:
            middle = round(rng.uniform(0.3, 0.7) * count)
            still = np.repeat(
                path[middle : middle + 1], round(rng.uniform(1, 3) * RATE), 0
            )
            add(path[:middle])
            add(still, "pause")
            add(path[middle:])
        else:
            add(path)
        cycles += (phase[-1] - phase[0]) / (2 * np.pi)
        moved += count - 1
        if bout == bouts - 1 and rng.random() < 0.6:
            end = path[-1] + away(rng.uniform(0.25, 0.5))
            add(eased(path[-1], end, round(rng.uniform(1.0, 3.0) * RATE)), "retreat")
    values = np.concatenate(pieces)
    values = values + smooth_noise(rng, len(values), channels, rng.uniform(2e-4, 1e-3))
    return Synthetic(values, moved / cycles / RATE, cycles, left_out)


APPROACHES = ("straight", "curved", "slow", "pause", "lift", "blended")
SHAPES = ("random", "circle", "strokes", "eight", "scrub")


def named_curve(rng, shape, channels):
    """Return a function from phases (n,) to points (n, D) of a curve of a shape."""
    if shape == "random":
        return random_curve(rng, channels)
    plane = np.linalg.qr(rng.standard_normal((channels, 2)))[0]
    width, angle = rng.uniform(0.4, 1.0), rng.uniform(0, 2 * np.pi)
    sign = rng.choice([-1, 1])
    x_and_y = {
        "circle": lambda p: (
            np.cos(p) + 0.08 * np.cos(2 * p + angle),
            width * np.sin(p) + 0.08 * np.sin(2 * p + angle),
        ),
        "strokes": lambda p: (np.cos(p), 0.15 * width * np.sin(p + angle)),
        "eight": lambda p: (np.sin(p), 0.6 * width * np.sin(2 * p)),
        "scrub": lambda p: (np.cos(p), 0.35 * width * np.sin(3 * p + angle)),
    }[shape]

    def curve(phase):
        return 0.1 * np.column_stack(x_and_y(sign * np.asarray(phase))) @ plane.T

    return curve


def approach_path(rng, kind, end, velocity):
    """Return a path (n, D) of a kind from rest to an end, where it has a velocity or rests."""
    direction = rng.standard_normal(len(end))
    start = end + rng.uniform(0.2, 0.5) * direction / np.linalg.norm(direction)
    count = round(
        rng.uniform(3, 6) * RATE if kind == "slow" else rng.uniform(1, 3) * RATE
    )
    path = eased(start, end, count)
    if kind == "curved":
        bend = rng.standard_normal(len(end))
        bend *= 0.4 * np.linalg.norm(start - end) / np.linalg.norm(bend)
        part = (path - start) @ (end - start) / np.sum((end - start) ** 2)
        path = path + 4 * (part * (1 - part))[:, None] * bend
    elif kind == "pause":
        path = np.vstack([path, np.tile(end, (round(rng.uniform(0.5, 2) * RATE), 1))])
    elif kind == "lift":
        above = end + 0.15 * rng.standard_normal(len(end))
        down = eased(above, end, round(rng.uniform(0.6, 1.5) * RATE))
        path = np.vstack([eased(start, above, count), down])
    elif kind == "blended":
        t = np.linspace(0, 1, count + 2)[1:-1, None]
        path = start + (end - start) * t**2 * (3 - 2 * t)
        path += (t**3 - t**2) * velocity * (count + 1)
    if rng.random() < 0.3:
        path = np.vstack(
            [np.tile(path[0], (round(rng.uniform(0.3, 2) * RATE), 1)), path]
        )
    return path


def few_cycles(seed, cycles, *, has_approach=True):
    """Draw a number of cycles, with an approach and a retreat of the same kind or without.

    Shape, tempo, amplitude and centre vary as those of a hand. Seeds differ in the kind of the
    approach and, by six, in the shape.
    """
    rng = np.random.default_rng([seed, round(100 * cycles)])
    channels = int(rng.integers(2, 4))
    kind = APPROACHES[seed % len(APPROACHES)]
    shape = SHAPES[seed // len(APPROACHES) % len(SHAPES)]
    curve = named_curve(rng, shape, channels)
    period = rng.uniform(1.5, 6.0) * RATE
    count = round(cycles * period) + 1
    phase = varying_phase(rng, count, period, rng.uniform(0, 0.1))
    phase = phase[0] + (phase - phase[0]) * 2 * np.pi * cycles / (phase[-1] - phase[0])
    path = curve(phase)
    if rng.random() < 0.5:
        width = round(period)
        noise = np.convolve(
            rng.standard_normal(count + width - 1), np.hanning(width), "valid"
        )
        path = path * (1 + 0.06 * noise / np.linalg.norm(np.hanning(width)))[:, None]
    if rng.random() < 0.5:
        drift = rng.standard_normal(channels)
        drift *= rng.uniform(0, 0.03) / np.linalg.norm(drift)
        path = path + np.linspace(0, 1, count)[:, None] * drift
    pieces, left_out = [path], []
    if has_approach:
        approach = approach_path(rng, kind, path[0], path[1] - path[0])
        retreat = approach_path(rng, kind, path[-1], path[-2] - path[-1])[::-1]
        pieces = [approach, path, retreat]
        begin, end = len(approach) / RATE, (len(approach) + count) / RATE
        left_out = [
            (0.0, begin, "approach"),
            (end, end + len(retreat) / RATE, "retreat"),
        ]
    values = np.concatenate(pieces)
    values = values + smooth_noise(rng, len(values), channels, rng.uniform(2e-4, 1e-3))
    return Synthetic(values, (count - 1) / RATE / cycles, cycles, left_out)


def with_pause(rng, values, at, seconds, *, height=0.0, up=0.7):
    """Return values (n, D) with a pause at a sample, where the movement stops within 0.3 s.

    With a height, m, it is at the top of a lift that takes a time up, s, and one down.
    """
    count = round(0.3 * RATE)
    first, stop = max(at - count, 0), min(at + count, len(values) - 1)
    times = np.linspace(0, 1, 2 * count + 1)
    slowing = times * (2 - times)

    def along(places):
        columns = (np.interp(places, np.arange(len(values)), c) for c in values.T)
        return np.column_stack(list(columns))

    before = along(first + (at - first) * slowing)
    after = along(stop - (stop - at) * slowing[::-1])
    direction = rng.standard_normal(values.shape[1])
    top = values[at] + height * direction / np.linalg.norm(direction)
    still = np.repeat(top[None], round(seconds * RATE), axis=0)
    still += 3e-5 * np.cumsum(rng.standard_normal(still.shape), axis=0)
    way = eased(values[at], top, round(up * RATE)) if height else values[:0]
    pieces = (values[:first], before, way, still, way[::-1], after, values[stop + 1 :])
    return np.concatenate(pieces)
