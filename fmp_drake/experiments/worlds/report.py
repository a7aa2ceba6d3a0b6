"""What a thousand worlds say: the findings of a store, for a page."""

import math
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from fmp_drake.experiments.finding import Finding
from fmp_drake.experiments.report import Section, write_page, write_report
from fmp_drake.experiments.worlds.judging import (
    LEAST_PRESSED,
    MOST_RMS,
    Fault,
    faults,
    is_pushed,
    largest_push,
)
from fmp_drake.experiments.worlds.pictures import (
    draw_figures,
    draw_places,
    draw_success,
    interval,
)
from fmp_drake.experiments.worlds.store import World, WorldStore
from fmp_drake.numeric import is_number
from fmp_drake.station import ParseScenario

IMPOSSIBLE = {
    "through": "bodies through another",
    "nan": "NaN",
    "limit": "limits broken",
    "exception": "exceptions",
}
_CLEAN = (
    "no body goes through another, nothing is NaN, no limit is broken, and there is no "
    "exception"
)
_WANTED = 0.99
_WORST, _REFUSED = 20, 20


class WorldsReport:
    """The findings of the worlds in a store.

    Parameters
    ----------
    store : WorldStore
        With a world at least.
    """

    def __init__(self, store: WorldStore) -> None:
        self._folder = store.folder
        self._seconds = float(store.plan["seconds"])
        self._seed = store.plan["seed"]
        self._worlds = store.worlds()
        self._faults = {w.number: faults(w) for w in self._worlds if w.was_run}
        # Those that are promised to go well.
        self._run = [w for w in self._worlds if w.is_feasible and w.was_run]
        self._refused = [w for w in self._worlds if not w.is_feasible]

    @property
    def title(self) -> str:
        """What the page is called."""
        return f"{len(self._worlds)} worlds of {self._seconds:g} s"

    def introduction(self) -> str:
        """Return the verdict, in a sentence or two."""
        n, good = len(self._run), len(self._good())
        kinds = self._kinds(self._run)
        seen = [f"{kinds[k]} with {name}" for k, name in IMPOSSIBLE.items() if kinds[k]]
        hours = sum(w.cpu_seconds for w in self._worlds) / 3600
        codes = sorted({w.code for w in self._worlds})
        return (
            f"Of {len(self._worlds)} worlds, drawn with seed {self._seed}, the check in "
            f"advance refuses {len(self._refused)}. Of the {n} others {good} go well "
            f"({_percent(good, n)}). Among them {', '.join(seen) or _CLEAN}. "
            f"It took {hours:.2f} hours of one core, with the code {', '.join(codes)}."
        )

    def write(self, page: Path | None = None) -> None:
        """Write `report.html` beside the worlds, and a Markdown page if wanted."""
        sections, text = self.sections(), self.introduction()
        write_report(
            self._folder,
            sections=sections,
            introduction=text,
            results=self.results(),
            title=self.title,
        )
        if page is not None:
            write_page(page, sections=sections, introduction=text, title=self.title)

    def sections(self) -> list[Section]:
        """Return the findings."""
        return [
            ("The verdict", self._verdict()),
            ("Where worlds go wrong", self._where()),
            ("The worst worlds", [self._worst()]),
            ("Refused in advance", self._refusals()),
        ]

    def worst(self, count: int) -> list[World]:
        """Return the feasible worlds that went wrong, the worst first."""
        wrong = [w for w in self._run if self._faults[w.number]]
        wrong.sort(key=lambda w: -self._faults[w.number][0].severity)
        return wrong[:count]

    def results(self) -> dict[str, Any]:
        """Return the numbers, for JSON."""
        return {
            "worlds": len(self._worlds),
            "seconds": self._seconds,
            "refused": len(self._refused),
            "run": len(self._run),
            "good": len(self._good()),
            "faults": self._kinds(self._run),
            "worst": [w.number for w in self.worst(_WORST)],
            "cpu_seconds": sum(w.cpu_seconds for w in self._worlds),
        }

    def _good(self) -> list[World]:
        return [w for w in self._run if not self._faults[w.number]]

    def _kinds(self, worlds: Sequence[World]) -> dict[str, int]:
        """Return in how many worlds there is each kind of fault."""
        kinds = dict.fromkeys([*IMPOSSIBLE, "path", "press"], 0)
        for world in worlds:
            for kind in {fault.kind for fault in self._faults[world.number]}:
                kinds[kind] += 1
        return kinds

    def _verdict(self) -> list[Finding]:
        n, kinds = len(self._run), self._kinds(self._run)
        impossible = {name: kinds[kind] for kind, name in IMPOSSIBLE.items()}
        followed = sum(not self._has(w, "path", "press") for w in self._run)
        groups: dict[str, list[World]] = {"all that can be followed": self._run}
        for name, pushed in (("nobody pushes", False), ("somebody pushes", True)):
            groups[name] = [
                w for w in self._run if is_pushed(w, self._seconds) == pushed
            ]
        for parameter in ("base", "skill.demonstration"):
            for value in sorted({w.parameters.get(parameter, "") for w in self._run}):
                these = [w for w in self._run if w.parameters.get(parameter) == value]
                groups.update({f"{value}": these} if value else {})
        groups["refused, and run by force"] = [w for w in self._refused if w.was_run]
        head = ["", "worlds", "good", "95 % interval", *IMPOSSIBLE.values()]
        head += [
            "path missed",
            "press missed",
            "off the path, median",
            "cleaned, median",
        ]
        return [
            Finding(
                name="impossible",
                title="What must never happen",
                shows=f"{', '.join(f'{v} {k}' for k, v in impossible.items())}, in {n} worlds.",
                claim="No body goes through another, no NaN, no limit broken, no exception.",
                agrees=not any(impossible.values()),
                table=[head, *(self._row(k, v) for k, v in groups.items() if v)],
            ),
            Finding(
                name="followed",
                title="Path and press",
                shows=f"{followed} of {n} worlds, {_percent(followed, n)}. Worlds with "
                "pushes are not judged by their press.",
                claim=f"Of the worlds that are not refused at least {100 * _WANTED:.0f} % "
                f"stay below {1e3 * MOST_RMS:.0f} mm rms off their path and, where nobody "
                f"pushes, within 5 N of the wanted force for {100 * LEAST_PRESSED:.0f} % "
                "of the time in contact.",
                agrees=n > 0 and followed >= _WANTED * n,
                figure=draw_figures(
                    {
                        name: [
                            (
                                1e3 * m["tracking_rms_m"],
                                100 * m["normal_force_wanted_fraction"],
                            )
                            for w in groups[name]
                            if (m := w.metrics) is not None
                        ]
                        for name in ("nobody pushes", "somebody pushes")
                    }
                ),
            ),
        ]

    def _has(self, world: World, *kinds: str) -> bool:
        return any(f.kind in (*kinds, "exception") for f in self._faults[world.number])

    def _row(self, name: str, worlds: Sequence[World]) -> list[str]:
        kinds = self._kinds(worlds)
        good = sum(not self._faults[w.number] for w in worlds)
        low, high = interval(good, len(worlds))
        return [
            name,
            str(len(worlds)),
            _percent(good, len(worlds)),
            f"{100 * low:.0f} to {100 * high:.0f} %",
            *(str(count) for count in kinds.values()),
            _median(worlds, "tracking_rms_m", lambda v: f"{1e3 * v:.1f} mm"),
            _median(
                worlds,
                "cleaned_fraction_of_demonstrated_area",
                lambda v: f"{100 * v:.0f} %",
            ),
        ]

    def _where(self) -> list[Finding]:
        if not self._run:
            return []
        good = [not self._faults[w.number] for w in self._run]
        names = [
            name
            for name in self._run[0].parameters
            if all(name in w.parameters for w in self._run)
            and not name.endswith("seed")
            and not name.startswith("disturbances")
        ]
        drawn = {name: [w.parameters[name] for w in self._run] for name in names}
        if any(pushes := [largest_push(w) for w in self._run]):
            drawn["largest push (N)"] = pushes
        return [
            Finding(
                name="success",
                title="Good worlds against each parameter",
                shows="Points are fractions of good worlds with their 95 % intervals, the "
                "grey line is that of all, and an orange tick is a world that went wrong.",
                figure=draw_success(drawn, good),
            )
        ]

    def _worst(self) -> Finding:
        rows = [
            [
                str(w.number),
                "; ".join(f.words for f in self._faults[w.number]) + ".",
                self._about(w),
                f"`{self.replay(w)}`",
            ]
            for w in self.worst(_WORST)
        ]
        wrong = len(self._run) - len(self._good())
        return Finding(
            name="worst",
            title="What went wrong in them",
            shows=f"{wrong} worlds went wrong; the {len(rows)} worst are here."
            if rows
            else "None went wrong.",
            table=[["world", "what went wrong", "what it is", "see it again"], *rows],
        )

    def _refusals(self) -> list[Finding]:
        forced = [w for w in self._refused if w.was_run]
        well = sum(not self._faults[w.number] for w in forced)
        shown = (forced or self._refused)[:_REFUSED]
        rows = [
            [str(w.number), w.verdict, self._fate(w), f"`{self.replay(w)}`"]
            for w in shown
        ]
        places: dict[str, list[list[float]]] = {"good": [], "wrong": [], "refused": []}
        for w in self._worlds:
            kind = "wrong" if self._faults.get(w.number) else "good"
            place = places[kind if w.is_feasible else "refused"]
            place.append(ParseScenario(w.scenario).board.translation)
        n = len(self._worlds)
        return [
            Finding(
                name="places",
                title="Where the boards are",
                shows=f"The check in advance refuses {len(self._refused)} of {n} worlds, "
                f"{_percent(len(self._refused), n)}.",
                figure=draw_places(places),
            ),
            Finding(
                name="refused",
                title="Why, and what happens nevertheless",
                shows=f"Of the {len(forced)} that were run by force, {well} went well."
                if forced
                else "None was run by force (`--force`).",
                table=[["world", "why", "run by force", "see it"], *rows],
            ),
        ]

    def _fate(self, world: World) -> str:
        if not world.was_run:
            return "no"
        found: list[Fault] = self._faults[world.number]
        return "; ".join(fault.words for fault in found) or "went well"

    def _about(self, world: World) -> str:
        """Say what a world is, where it differs most."""
        s = ParseScenario(world.scenario)
        x, y, z = s.board.translation
        parts = [
            str(world.parameters.get("base", "")),
            s.skill.demonstration,
            f"board at ({x:.2f}, {y:.2f}, {z:.2f}) m",
            f"off by {1e3 * s.board.error.translation[2]:.1f} mm in height",
            f"felt of {s.eraser.modulus / 1e3:.0f} kPa",
            f"tempo {s.skill.tempo:.2f}",
            f"{s.press.force:.1f} N",
        ]
        if push := largest_push(world):
            parts.append(f"pushed with {push:.0f} N")
        return ", ".join(part for part in parts if part)

    def replay(self, world: World) -> str:
        """Return the command that shows a world again."""
        page = f"world_{world.number}.html"
        return f"fmp-drake worlds {self._folder} --replay {world.number} --html {page}"


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f} %" if whole else "-"


def _median(worlds: Sequence[World], name: str, shown: Callable[[float], str]) -> str:
    values = [
        w.metrics[name] for w in worlds if w.metrics and is_number(w.metrics[name])
    ]
    finite = [value for value in values if math.isfinite(value)]
    return shown(statistics.median(finite)) if finite else "-"
