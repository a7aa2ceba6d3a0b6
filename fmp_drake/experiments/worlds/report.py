"""What many worlds show: the findings of a store, for a page."""

import statistics
from collections.abc import Sequence
from pathlib import Path

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.finding import Finding
from fmp_drake.experiments.report import Section, write_page, write_report
from fmp_drake.experiments.worlds.judging import (
    LEAST_PRESSED,
    MOST_RMS,
    faults,
    is_pushed,
    largest_push,
    misses_by_height,
    on_board_rms,
)
from fmp_drake.experiments.worlds.pictures import (
    draw_figures,
    draw_success,
    interval,
)
from fmp_drake.experiments.worlds.store import World, WorldStore

# What must never be, and what a world is judged by beside it.
_NEVER = {
    "through": "bodies through another",
    "nan": "NaN",
    "limit": "limits broken",
    "exception": "exceptions",
}
_KINDS = {
    **_NEVER,
    "path": "path missed",
    "press": "press missed",
    "touch": "arm on the board",
}
_CLEAN = "no body through another, no NaN, no limit broken, no exception"
_UNKNOWN = " How deep bodies were in others was not measured."
# Fraction of good worlds that is wanted, and rows of the tables of worlds.
_WANTED, _ROWS = 0.99, 20


class WorldsReport:
    """The findings of the worlds in a store.

    Good are those in which nothing went wrong, of those that the check in advance does
    not refuse.

    Parameters
    ----------
    store : WorldStore
        With a world at least.

    Examples
    --------
    >>> WorldsReport(WorldStore(Path("out"), {"seconds": "9.0", "seed": "0"}))
    Traceback (most recent call last):
    fmp_drake.errors.ExperimentError: there are no worlds in out yet.
    """

    def __init__(self, store: WorldStore) -> None:
        self._folder, self._plan = store.folder, store.plan
        self._worlds = store.worlds()
        if not self._worlds:
            raise ExperimentError(f"there are no worlds in {store.folder} yet.")
        self._faults = {w.number: faults(w) for w in self._worlds if w.was_run}
        self._run = [w for w in self._worlds if w.is_feasible and w.was_run]
        self._refused = [w for w in self._worlds if not w.is_feasible]
        self._wrong = [w for w in self._run if self._faults[w.number]]
        measured = all("penetration_max_m" in w.metrics for w in self._run if w.metrics)
        self._unknown = "" if measured else _UNKNOWN
        self._wrong.sort(key=lambda w: -self._faults[w.number][0].severity)

    def write(self, page: Path | None = None) -> None:
        """Write report.html beside the worlds, and a page in Markdown where wanted."""
        title = f"{len(self._worlds)} worlds of {float(self._plan['seconds']):g} s"
        sections: list[Section] = [
            ("The verdict", [self._impossible(), self._followed()]),
            ("Where worlds go wrong", [self._success(), self._worst()]),
            ("Refused in advance", [self._refusals()]),
        ]
        text = self.verdict()
        results = {
            "worlds": len(self._worlds),
            "refused": len(self._refused),
            "faults": self._count(self._run),
            "worst": [world.number for world in self._wrong[:_ROWS]],
            "cpu_seconds": sum(world.cpu_seconds for world in self._worlds),
        }
        write_report(
            self._folder,
            sections=sections,
            introduction=text,
            results=results,
            title=title,
        )
        if page is not None:
            write_page(page, sections=sections, introduction=text, title=title)

    def verdict(self) -> str:
        """Return what the worlds show, in some sentences."""
        n, good = len(self._run), len(self._run) - len(self._wrong)
        counts = self._count(self._run)
        seen = [
            f"{counts[kind]} with {what}"
            for kind, what in _NEVER.items()
            if counts[kind]
        ]
        hours = sum(world.cpu_seconds for world in self._worlds) / 3600
        return (
            f"Of {len(self._worlds)} worlds, drawn with seed {self._plan['seed']}, the "
            f"check in advance refuses {len(self._refused)}. Of the {n} others {good} go "
            f"well ({_percent(good, n)}), {', '.join(seen) or _CLEAN}. They took "
            f"{hours:.2f} hours of one core, with the code "
            f"{', '.join(sorted({world.code for world in self._worlds}))}.{self._unknown}"
        )

    def _count(self, worlds: Sequence[World]) -> dict[str, int]:
        """Return in how many worlds there is each kind of fault."""
        kinds = [{fault.kind for fault in self._faults[w.number]} for w in worlds]
        return {kind: sum(kind in each for each in kinds) for kind in _KINDS}

    def _by_push(self) -> dict[str, list[World]]:
        seconds = float(self._plan["seconds"])
        pushed = {w.number for w in self._run if is_pushed(w, seconds)}
        return {
            "nobody pushes": [w for w in self._run if w.number not in pushed],
            "somebody pushes": [w for w in self._run if w.number in pushed],
        }

    def _impossible(self) -> Finding:
        groups = {"all that are not refused": self._run, **self._by_push()}
        for name in ("base", "skill.demonstration"):
            for world in sorted(self._run, key=lambda w: str(w.parameters.get(name))):
                if name in world.parameters:
                    groups.setdefault(str(world.parameters[name]), []).append(world)
        groups["refused, run by force"] = [w for w in self._refused if w.was_run]
        columns = ["", "worlds", "good", "95 % interval", *_KINDS.values()]
        columns += ["off the path, median", "cleaned, median"]
        counts = self._count(self._run)
        found = [f"{counts[kind]} {what}" for kind, what in _NEVER.items()]
        return Finding(
            name="impossible",
            title="What must never happen",
            shows=f"{', '.join(found)}, in {len(self._run)} worlds.{self._unknown}",
            claim=f"N{_CLEAN[1:]}.",
            agrees=not self._unknown and not any(counts[kind] for kind in _NEVER),
            table=[columns, *(self._row(k, v) for k, v in groups.items() if v)],
        )

    def _row(self, name: str, worlds: Sequence[World]) -> list[str]:
        n, good = len(worlds), sum(not self._faults[w.number] for w in worlds)
        low, high = interval(good, n)
        cleaned = "cleaned_fraction_of_demonstrated_area"
        found = [m for w in worlds if (m := w.metrics)]
        rms = [1e3 * on_board_rms(w) for w in worlds if w.metrics]
        return [
            *(
                name,
                str(n),
                _percent(good, n),
                f"{100 * low:.0f} to {100 * high:.0f} %",
            ),
            *map(str, self._count(worlds).values()),
            _median(rms, "{:.1f} mm"),
            _median([100 * m[cleaned] for m in found], "{:.0f} %"),
        ]

    def _followed(self) -> Finding:
        n, missed = len(self._run), {"path", "press", "exception"}
        kinds = [{fault.kind for fault in self._faults[w.number]} for w in self._run]
        followed = sum(not each & missed for each in kinds)
        high = [w.number for w in self._run if misses_by_height(w)]
        why = (
            " The distance is that on the board as it is. From where the board was assumed, "
            f"with the felt not yielding, it is too large in these, too: {_listed(high)}."
        )
        return Finding(
            name="followed",
            title="Path and press",
            shows=f"{followed} of {n} worlds, {_percent(followed, n)}. Worlds with pushes "
            f"are not judged by their press.{why if high else ''}",
            claim=f"Of the worlds that are not refused at least {100 * _WANTED:.0f} % stay "
            f"below {1e3 * MOST_RMS:.0f} mm rms off their path and, where nobody pushes, "
            f"within 5 N of the wanted force for {100 * LEAST_PRESSED:.0f} % of the time "
            "in contact.",
            agrees=n > 0 and followed >= _WANTED * n,
            figure=draw_figures(
                {
                    name: [
                        (on_board_rms(world), m["normal_force_wanted_fraction"])
                        for world in worlds
                        if (m := world.metrics)
                    ]
                    for name, worlds in self._by_push().items()
                }
            ),
        )

    def _success(self) -> Finding:
        drawn = {
            name: [w.parameters[name] for w in self._run]
            for name in (self._run[0].parameters if self._run else ())
            if not name.endswith("seed")
            and all(name in w.parameters for w in self._run)
        }
        drawn["largest push (N)"] = [largest_push(w) for w in self._run]
        return Finding(
            name="success",
            title="Good worlds against each parameter",
            shows="Points are fractions of good worlds with their 95 % intervals, the grey "
            "line is that of all, and an orange tick is a world that went wrong.",
            figure=draw_success(drawn, [not self._faults[w.number] for w in self._run]),
        )

    def _worst(self) -> Finding:
        rows = [
            [str(w.number), self._words(w), _about(w), self._command(w)]
            for w in self._wrong[:_ROWS]
        ]
        return Finding(
            name="worst",
            title="The worst worlds",
            shows=f"{len(self._wrong)} went wrong; the {len(rows)} worst are shown.",
            table=[["world", "what went wrong", "what it is", "see it again"], *rows]
            if rows
            else None,
        )

    def _refusals(self) -> Finding:
        n, forced = len(self._worlds), [w for w in self._refused if w.was_run]
        well = sum(not self._faults[w.number] for w in forced)
        rows = [
            [str(w.number), w.verdict, self._words(w), self._command(w)]
            for w in (forced or self._refused)[:_ROWS]
        ]
        return Finding(
            name="refused",
            title="Why they are refused, and what happens nevertheless",
            shows=f"{len(self._refused)} are refused, {_percent(len(self._refused), n)}. "
            f"{len(forced)} were run by force, of which {well} went well.",
            table=[["world", "why", "run by force", "see it"], *rows] if rows else None,
        )

    def _words(self, world: World) -> str:
        found = self._faults.get(world.number)
        if found is None:
            return "not run"
        words = "; ".join(fault.words for fault in found) or "went well"
        return f"{words}. The run says: {world.events}." if world.events else words

    def _command(self, world: World) -> str:
        page = f"world_{world.number}.html"
        return (
            f"`fmp-drake worlds {self._folder} --replay {world.number} --html {page}`"
        )


def _about(world: World) -> str:
    """Say what a world is."""
    board, skill = world.fields["board"], world.fields["skill"]
    height = board["error"]["translation"][2]
    place = ", ".join(f"{value:.2f}" for value in board["translation"])
    parts = [
        f"{world.parameters.get('base', '')} {skill['demonstration']}".strip(),
        f"board at ({place}) m",
        f"{1e3 * abs(height):.1f} mm {'lower' if height < 0 else 'higher'} than assumed",
        f"felt of {world.fields['eraser']['modulus'] / 1e3:.0f} kPa",
        f"tempo {skill['tempo']:.2f}",
        f"{world.fields['press']['force']:.1f} N",
    ]
    push = largest_push(world)
    return ", ".join([*parts, f"pushed with {push:.0f} N"] if push else parts)


def _listed(numbers: Sequence[int]) -> str:
    shown = ", ".join(map(str, numbers[:_ROWS]))
    return f"{shown} and {len(numbers) - _ROWS} others" if numbers[_ROWS:] else shown


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f} %" if whole else "-"


def _median(values: Sequence[float], shown: str) -> str:
    """Return the median as it is to be shown; it is NaN where a value is."""
    return shown.format(statistics.median(values)) if values else "-"
