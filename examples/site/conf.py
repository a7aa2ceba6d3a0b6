"""The documentation site: ``make docs``."""

import os
import re
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import matplotlib as mpl
from sphinx.application import Sphinx
from sphinx.util import logging

import fmp_drake

mpl.use("Agg")

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
GENERATED = HERE / "generated"
FRONT_DOORS = {
    "fmp_drake.primitives": "The skill: learned, mapped, played, edited. No Drake.",
    "fmp_drake.systems": "Drake systems: the primitive, the controller, ink, people.",
    "fmp_drake.station": "A robot at a whiteboard, wired from a scenario.",
    "fmp_drake.skills": "A skill for a station: found, learned, placed on a surface.",
    "fmp_drake.runs": "A station with its metrics and its log.",
    "fmp_drake.plots": "Pictures of recordings, skills and runs.",
    "fmp_drake.film": "Films of a run, without a screen.",
    "fmp_drake.experiments": "The paper's experiments, and scores on unseen data.",
    "fmp_drake.experiments.trials": "Randomised scenarios, run and judged.",
    "fmp_drake.experiments.benchmark": "Methods compared on any recordings.",
    "fmp_drake.experiments.baselines": "Other movement primitives, for comparison.",
}
# Tasks of a user, and the modules with the public names for them.
TASKS = {
    "Read and learn": ("primitives.data", "primitives.model", "primitives.discrete"),
    "Play and edit": ("primitives",),
    "Place a skill on a surface": ("skills",),
    "Build a station": ("station",),
    "Systems for your own diagram": ("systems",),
    "Run, log, teach": ("runs",),
    "Draw and film": ("plots", "film"),
    "Judge and compare": ("experiments",),
}
# With the tag "quick", to test that the site can be built, replays are short, and of the
# examples, which have tests of their own, only those are run whose pictures pages show.
IS_QUICK = tags.has("quick")  # noqa: F821, of Sphinx
REPLAY_SECONDS = 1.0 if IS_QUICK else 8.0


def shown_examples() -> list[str]:
    """Return the names of the examples of which a page shows a picture."""
    text = "".join(path.read_text("utf-8") for path in HERE.glob("*/*.rst"))
    return sorted(set(re.findall(r"/sphx_glr_(\w+)_\d{3}\.png", text)))


project = "fmp_drake"
author = "the fmp_drake authors"
version = release = fmp_drake.__version__
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_gallery.gen_gallery",
    "numpydoc",
    "sphinx-mathjax-offline",
]
templates_path = ["templates"]
exclude_patterns = ["templates"]
html_theme = "pydata_sphinx_theme"
html_title = f"fmp_drake {version}"
html_css_files = ["site.css"]
html_static_path = ["static"]
html_show_sourcelink = False
# Pages without a sidebar.
_WITHOUT_SIDEBAR = (
    *("start", "faq", "mathematics", "results", "limits"),
    *("generated/scenarios", "generated/changelog"),
)
html_sidebars = {name: [] for name in _WITHOUT_SIDEBAR}
html_favicon = "static/favicon.svg"
html_theme_options = {
    "show_prev_next": False,
    "navigation_with_keys": False,
    "header_links_before_dropdown": 6,
    "footer_start": ["copyright"],
    "footer_end": [],
}
# The address of the repository is known where the site is published from it.
if (server := os.environ.get("GITHUB_SERVER_URL")) and (
    repository := os.environ.get("GITHUB_REPOSITORY")
):
    html_theme_options["icon_links"] = [
        {
            "name": "Repository",
            "url": f"{server}/{repository}",
            "icon": "fa-brands fa-github",
        }
    ]
project_copyright = "2026, the fmp_drake authors"
autosummary_generate = True
autodoc_typehints = "none"
autodoc_preserve_defaults = True
numpydoc_show_class_members = False
toc_object_entries_show_parents = "hide"
sphinx_gallery_conf = {
    "examples_dirs": [".."],
    "gallery_dirs": ["gallery"],
    "filename_pattern": f"/({'|'.join(shown_examples())})" if IS_QUICK else r"/\d\d_",
    "ignore_pattern": r"/site/",
    "within_subsection_order": "FileNameSortKey",
    "min_reported_time": 1e9,
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_signature": False,
    "plot_gallery": True,
    "abort_on_example_error": True,
}


def heading(title: str, mark: str) -> list[str]:
    """Return the lines of a heading that is underlined with a mark."""
    return [title, mark * len(title), ""]


def write_api(folder: Path) -> None:
    """Write a page for each front door, with every public name."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [*heading("API", "="), "By task; by package at the end.", ""]
    by_task: dict[str, list[str]] = {task: [] for task in TASKS}
    for name, purpose in FRONT_DOORS.items():
        public = import_module(name).__all__
        for symbol in public:
            module = getattr(getattr(import_module(name), symbol), "__module__", None)
            by_task[task_of(str(module or name))].append(f"{name}.{symbol}")
        classes = [n for n in public if n[0].isupper() and not n.isupper()]
        others = [n for n in public if n not in classes]
        page = [*heading(name, "="), purpose, "", f".. currentmodule:: {name}", ""]
        for group in (classes, others):
            if group:
                page += [".. autosummary::", "   :toctree: ../api", ""]
                page += [*(f"   {symbol}" for symbol in group), ""]
        (folder / f"{name}.rst").write_text("\n".join(page), encoding="utf-8")
    for task, names in by_task.items():
        lines += [*heading(task, "-"), ".. autosummary::", "   :nosignatures:", ""]
        lines += [*(f"   ~{name}" for name in names), ""]
    lines += [*heading("By package", "-"), ".. toctree::", "   :maxdepth: 1", ""]
    lines += [f"   {name}" for name in FRONT_DOORS]
    (folder / "index.rst").write_text("\n".join([*lines, ""]), encoding="utf-8")


def task_of(module: str) -> str:
    """Return the first task whose modules contain a module."""
    inner = module.removeprefix("fmp_drake.") + "."
    return next(
        task
        for task, packages in TASKS.items()
        if any(inner.startswith(f"{package}.") for package in packages)
    )


def write_changelog(folder: Path) -> None:
    """Write the changelog, which is in Markdown, as a page."""
    lines: list[str] = []
    for line in (HERE.parents[1] / "CHANGELOG.md").read_text("utf-8").splitlines():
        line = line.replace("`", "``").replace("*.md", r"\*.md")
        marks, _, title = line.partition(" ")
        if title and set(marks) == {"#"}:
            lines += ["", *heading(title, "=-~"[len(marks) - 1])]
        elif not line.startswith("|"):
            lines.append(line)
        elif not line.startswith("|---"):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            lines.append(f"- {' -> '.join(cells)}")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "changelog.rst").write_text("\n".join([*lines, ""]), encoding="utf-8")


def write_scenarios(folder: Path, replays: Path) -> None:
    """Run every scenario, write its replay, and a page that embeds them."""
    from fmp_drake.apps.page import open_page
    from fmp_drake.runs import MakeRun
    from fmp_drake.skills import scenario_skill
    from fmp_drake.station import ListScenarios, LoadScenario

    folder.mkdir(parents=True, exist_ok=True)
    replays.mkdir(parents=True, exist_ok=True)
    lines = [
        *heading("Scenarios", "="),
        f"A replay of {REPLAY_SECONDS:g} s of each scenario; the settings of the viewer",
        "control time and speed. ``fmp-drake wipe --scenario NAME`` runs a scenario for any",
        "duration; ``fmp-drake scenarios`` lists them.",
        "",
    ]
    for name in ListScenarios():
        scenario = LoadScenario(name)
        file = replays / f"{name}.html"
        if not file.exists():
            skill, demonstrations, _ = scenario_skill(scenario)
            panel = open_page()
            run = MakeRun(
                scenario,
                skill,
                demonstrations=demonstrations,
                meshcat=panel.meshcat,
                recording=True,
            )
            run.advance_to(REPLAY_SECONDS)
            run.remove_controls()
            file.write_text(run.html(title=name), encoding="utf-8")
            panel.close()
        lines += [*heading(name, "-"), scenario.description, ""]
        lines += [
            ".. raw:: html",
            "",
            f'   <iframe class="replay" loading="lazy" title="replay of {name}"',
            f'     src="../replays/{name}.html"></iframe>',
            "",
        ]
    (folder / "scenarios.rst").write_text("\n".join(lines), encoding="utf-8")


def show_ports(*event: Any) -> None:
    """Turn the sections of ports, which numpydoc does not support, into rubrics."""
    lines: list[str] = event[-1]
    text = re.sub(
        r"^(Input|Output) ports?\n-+\n",
        r".. rubric:: \1 ports\n\n",
        "\n".join(lines),
        flags=re.MULTILINE,
    )
    lines[:] = text.split("\n")


def check_links(app: Sphinx, failure: Exception | None) -> None:
    """Warn about each broken link inside the site."""
    from links import dead_links

    if failure is None:
        for line in dead_links(Path(app.outdir)):
            logging.getLogger(__name__).warning(line)


def setup(app: Sphinx) -> None:
    """Write the pages that are generated from the package, before Sphinx reads the pages."""
    from idea import draw_idea

    write_api(GENERATED)
    write_changelog(GENERATED)
    draw_idea(GENERATED / "idea.png")
    write_scenarios(GENERATED, Path(app.outdir) / "replays")
    app.connect("autodoc-process-docstring", show_ports, priority=100)
    app.connect("build-finished", check_links)
