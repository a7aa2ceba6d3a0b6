"""`fmp-drake reproduce`."""

import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from fmp_drake.apps.options import command, option
from fmp_drake.apps.page import make_console, make_folder
from fmp_drake.experiments import FULL, QUICK, Profile, write_report
from fmp_drake.experiments.report import Section
from fmp_drake.experiments.reproduction import run_experiments
from fmp_drake.primitives.data.reading.table import count_text


@dataclass(frozen=True, kw_only=True)
class ReproduceOptions:
    """Experiments, and files to write."""

    out: Path = option(help="Folder to write into.")
    quick: bool = option(False, "Fewer samples and seeds: about three minutes.")


@command(
    {
        "fmp-drake reproduce --out report --quick": "the report in about three minutes",
    }
)
def reproduce(to: ReproduceOptions) -> None:
    """Rerun the paper's experiments and write a report with figures and tables."""
    console = make_console()
    profile = QUICK if to.quick else FULL
    make_folder(to.out)

    start = time.perf_counter()
    with console.status("polishing") as status:

        def progress(message: str) -> None:
            line = f"{time.perf_counter() - start:4.0f} s  {message}"
            status.update(line)
            if not console.is_terminal:
                console.print(line)

        sections, results = run_experiments(profile, progress)
    results["seconds"] = time.perf_counter() - start
    write_report(
        to.out, sections=sections, introduction=_introduction(profile), results=results
    )
    _print_verdicts(console, sections)
    console.print(f"wrote {to.out / 'report.html'} in {results['seconds']:.0f} s")


def _introduction(profile: Profile) -> str:
    return (
        "Section V of Kulak, Silvério and Calinon, “Fourier movement primitives”, "
        "RSS 2020, rerun on recordings of a simulated arm guided by a modelled hand (the "
        "paper's own recordings are not public). FMP is the default model of the estimator; "
        "in V-B and V-C it is the mixture of the paper with the estimator's defaults, or, "
        "where that is said, with the paper's settings: 10 Gaussians, windows 10 samples "
        f"apart, plain EM. {profile.samples} trajectories for each heatmap; held out, "
        f"{profile.instants} predictions for each of {count_text(profile.places, 'place')}."
    )


def _print_verdicts(console: Console, sections: list[Section]) -> None:
    for _, findings in sections:
        for finding in findings:
            if finding.agrees is not None:
                verdict = "holds" if finding.agrees else "does not hold"
                console.print(f"{verdict:13}  {finding.title}")
            if finding.agrees is False:
                console.print(f"    claim: {finding.claim}")
                console.print(f"    found: {finding.shows}")
