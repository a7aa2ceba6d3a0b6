"""Skills of a scenario: the demonstrations to learn from, and learning."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from fmp_drake.errors import DemonstrationError, RunError
from fmp_drake.numeric import Array, as_path, check_number
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    ReadingOptions,
    find_rhythm,
    load_skill,
)
from fmp_drake.primitives.data.channels import (
    FORCE_CHANNEL,
    POSITION_CHANNELS,
    ChannelScales,
    channel_scales,
)
from fmp_drake.primitives.data.windows import demonstration_list
from fmp_drake.primitives.model.mapping import LruCache
from fmp_drake.primitives.model.movement_primitive import ModelChoice
from fmp_drake.skills.loading import load_on_board
from fmp_drake.station import Scenario, models_dir
from fmp_drake.station.scenario import check_scenario

# Highest frequency of an intended force, Hz. Tremor has 8 to 12 Hz (J. H. McAuley, C.
# D. Marsden, "Physiological and pathological tremors and rhythmic central motor
# control", Brain 123, 2000), and so has its effect on a contact.
_FORCE_BAND = 4.0
# Factor by which deviations of other channels than the position are reduced. With less, the
# rise of the force after landing ends a bout, and whole cycles are not learned.
_LESS_EXACT = 8.0
# Placed demonstrations; and skills, which have up to 40 MB each, by all that they depend on.
_PLACED = LruCache[list[Demonstration]](64)
_LEARNED = LruCache[tuple[FourierMovementPrimitive, list[Demonstration]]](8)


def bundled_demonstrations() -> list[str]:
    """Return the names of the demonstrations that come with the package."""
    return sorted(path.stem for path in _folder().glob("*.npz"))


def default_demonstration(task: str = "wiping") -> Path:
    """Return the path of a bundled demonstration by its name, or a path unchanged."""
    path = as_path(task, "the demonstration", error=DemonstrationError)
    if path.suffix or (task and path.is_dir()):
        return path
    if task not in bundled_demonstrations():
        raise DemonstrationError(
            f"there is no demonstration {task}; give a file or one of: "
            f"{', '.join(bundled_demonstrations())}."
        )
    return _folder() / f"{task}.npz"


def _folder() -> Path:
    return models_dir() / "demonstrations"


def scenario_skill(
    scenario: Scenario,
    *,
    demonstrations: str | Path | Sequence[str | Path] = (),
    skill_file: str | Path | None = None,
    transform: Sequence[float] | None = None,
    stretch: float = 1.0,
    window: float | None = None,
    n_components: int | None = None,
    model: ModelChoice | None = None,
    reading: ReadingOptions | None = None,
    surface: str | None = None,
    extra: Sequence[str] = (),
) -> tuple[FourierMovementPrimitive, list[Demonstration], list[str]]:
    """Load or learn the skill of a scenario; arguments take precedence over it.

    Without a `window` that of other `demonstrations` follows from their period.

    With a `surface` the scenario's board becomes the one fitted to the demonstrations, and
    `extra` channels are learned; see `load_on_board`.

    Returns
    -------
    skill : FourierMovementPrimitive
    demonstrations : list of Demonstration
        Demonstrations of the skill; empty for a skill from a file.
    remarks : list of str
    """
    check_scenario(scenario, "scenario_skill(scenario)")
    if skill_file is not None and demonstrations:
        raise RunError("give either --demo or --skill, not both.")
    config = scenario.skill
    if skill_file is None and config.file and not demonstrations:
        skill_file = Path(config.file)
    if skill_file is not None:
        of_learning = {
            "--window": window,
            "--n-components": n_components,
            "--transform": transform,
            "--stretch": None if stretch == 1.0 else stretch,
            "--surface": surface,
            "--extra": extra or None,
            "those of a recording": None if reading == ReadingOptions() else reading,
        }
        if given := [name for name, value in of_learning.items() if value is not None]:
            raise RunError(
                f"{skill_file} is a learned skill: leave out the options for learning "
                f"({', '.join(given)})."
            )
        skill, remarks = load_skill(skill_file), [f"loaded {skill_file}"]
        if not skill.paths_:
            remarks.append(
                f"{Path(skill_file).name} has no demonstrated paths, as after "
                "modulate_skill or learning from windows, so its playback is not bounded "
                "by them"
            )
        return skill, [], remarks
    recordings, remarks = load_on_board(
        demonstrations or [default_demonstration(config.demonstration)],
        scenario=scenario,
        transform=transform,
        stretch=stretch,
        reading=reading,
        surface=surface,
        extra=extra,
    )
    if window is None and not demonstrations:
        window = config.window  # It is for the scenario's own demonstration.
    skill = learn_skill(
        recordings,
        window=window,
        n_components=config.n_components if n_components is None else n_components,
        model=model or cast(ModelChoice, config.model),
        by_position=surface is not None,
    )
    return skill, recordings, remarks


def shared_skill(
    scenario: Scenario,
) -> tuple[FourierMovementPrimitive, list[Demonstration]]:
    """Return the skill of a scenario and its demonstrations, which are learned once.

    Robot and board count only where the placed demonstrations depend on them.
    """
    config, recordings = scenario.skill, list[Demonstration]()
    if not config.file:
        source = default_demonstration(config.demonstration)
        place = (scenario.robot, *scenario.board.size, *scenario.board_footprint())
        recordings = _PLACED.get(
            (source, _changed(source), *place),
            lambda: load_on_board([source], scenario=scenario)[0],
        )
    content = [(d.channels, d.time.tobytes(), d.values.tobytes()) for d in recordings]
    settings = (config.file, config.window, config.n_components, config.model)
    changed = _changed(Path(config.file)) if config.file else 0
    skill, recordings = _LEARNED.get(
        (*settings, changed, *content), lambda: scenario_skill(scenario)[:2]
    )
    return skill, [*recordings]


def _changed(path: Path) -> int:
    """Return the time of the last change of a file, ns; 0 where there is none."""
    return path.stat().st_mtime_ns if path.exists() else 0


def learn_skill(
    demonstrations: Demonstration | Sequence[Demonstration],
    *,
    window: float | None = None,
    n_components: int | None = None,
    model: ModelChoice | None = None,
    start_time: float | None = None,
    end_time: float | None = None,
    period: float | None = None,
    by_position: bool = False,
    progress: Callable[[str], None] | None = None,
) -> FourierMovementPrimitive:
    """Learn a skill with the options of the command line; None for the defaults.

    Without a window its length follows from the period of the movement. `start_time`,
    `end_time` and `period` are those of `FourierMovementPrimitive.fit`. With
    `by_position` the phase follows mainly from x, y and z: orientation and force of a
    person's hand repeat less exactly.
    """
    demonstrations = demonstration_list(demonstrations, "learn_skill")
    scales: ChannelScales = "units"
    if by_position and set(POSITION_CHANNELS) < set(demonstrations[0].channels):
        scales = _scales_by_position(demonstrations)
        if period is None and start_time is None and end_time is None:
            period = _period_of_position(demonstrations)
    default = FourierMovementPrimitive()
    rate, n_steps, overlap = default.rate, None, default.overlap
    if window is not None:
        check_number(window, "window", above=0, unit="s", error=DemonstrationError)
        n_steps = max(8, round(window * rate))
        overlap = min(overlap, n_steps // 4)
    skill = FourierMovementPrimitive(
        model=default.model if model is None else model,
        n_steps=n_steps,
        n_components=default.n_components if n_components is None else n_components,
        overlap=overlap,
        scales=scales,
    )
    try:
        return skill.fit(
            [_without_tremor(d, rate) for d in demonstrations],
            start_time=start_time,
            end_time=end_time,
            period=period,
            progress=progress,
        )
    except DemonstrationError as error:
        # Where cycles are found, the windows are shortened instead.
        longest = max((d.duration for d in demonstrations), default=np.inf)
        if n_steps is None or longest >= n_steps / rate:
            raise
        raise DemonstrationError(
            f"the longest demonstration lasts {longest:.3g} s, a window {window:g} s, and "
            "no cycles were found. Record for longer, choose shorter windows (--window) "
            "that still hold a whole period, or slow the demonstration down (--stretch)."
        ) from error


def _without_tremor(recording: Demonstration, rate: float) -> Demonstration:
    """Return the parts between gaps, at a rate in Hz, with the force low-pass filtered.

    An arm that repeats the tremor of a person's force shakes until its torques reach
    their rate limit; then it follows neither force nor path.
    """
    if FORCE_CHANNEL not in recording.channels:
        return recording
    from scipy.signal import butter, sosfiltfilt  # Slow to import.

    force = recording.channels.index(FORCE_CHANNEL)
    low_pass = butter(4, _FORCE_BAND, fs=rate, output="sos")
    parts = []
    for part in recording.split_at_gaps(rate) or [recording]:
        even = part.resample(rate)
        values = even.values.copy()
        padding = min(len(values) - 1, round(rate))
        values[:, force] = sosfiltfilt(low_pass, values[:, force], padlen=padding)
        parts.append((even.time, values))
    time, values = map(np.concatenate, zip(*parts, strict=True))
    return replace(recording, time=time, values=values)


def _scales_by_position(demonstrations: Sequence[Demonstration]) -> Array:
    """Return scales of channels (D,), eight times as large except for x, y and z."""
    first = demonstrations[0]
    values = np.concatenate([d.values for d in demonstrations])
    others = [name not in POSITION_CHANNELS for name in first.channels]
    scales = channel_scales("units", values, first.units)
    return scales * np.where(others, _LESS_EXACT, 1.0)


def _period_of_position(demonstrations: Sequence[Demonstration]) -> float | None:
    """Return the period of x, y and z, s; None where they do not repeat."""
    try:
        return find_rhythm([d.select(POSITION_CHANNELS) for d in demonstrations]).period
    except DemonstrationError:
        return None
