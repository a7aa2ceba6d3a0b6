"""`fmp-drake scenarios`."""

from dataclasses import dataclass
from pathlib import Path

from fmp_drake.apps.options import command, option
from fmp_drake.apps.page import make_console, print_table
from fmp_drake.errors import RunError
from fmp_drake.experiments.scenario_page import measure_scenarios, scenario_page
from fmp_drake.primitives.data.files import check_writable, write_text
from fmp_drake.station import ListScenarios, LoadScenario


@dataclass(frozen=True, kw_only=True)
class ScenariosOptions:
    """Page about all scenarios."""

    markdown: Path | None = option(
        None,
        "Run all scenarios, and write a file (.md) with a table of their metrics and a "
        "picture of each beside it.",
    )
    duration: float = option(60.0, "Simulated time of each run, s.", above=0)


@command({"fmp-drake scenarios": "the names, for --scenario NAME"})
def scenarios(to: ScenariosOptions) -> None:
    """List the scenarios that come with the package."""
    console, markdown = make_console(), to.markdown
    check_writable(markdown, "Markdown", [".md"])
    names = ListScenarios()
    if markdown is None:
        print_table(console, {name: LoadScenario(name).description for name in names})
        console.print("run one of them: fmp-drake wipe --scenario NAME")
        return
    runs = {}
    for name, run in measure_scenarios(names, to.duration, markdown.parent):
        runs[name] = run
        console.print(f"measured {name}")
    runs = {name: runs[name] for name in names}
    write_text(markdown, scenario_page(runs, duration=to.duration), RunError)
    console.print(f"wrote {markdown}")
