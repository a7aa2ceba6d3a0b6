"""Findings of experiments, and their report as HTML or Markdown."""

import base64
import html
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from fmp_drake.errors import ExperimentError
from fmp_drake.primitives.data.files import replaced, write_json, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure  # Slow to import.

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 70rem;
       margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.8rem; } h2 { margin-top: 3rem; border-bottom: 1px solid #ccc; }
img { max-width: 100%; } table { border-collapse: collapse; margin: 1rem 0;
       font-size: .88rem; }
th, td { padding: .25rem .5rem; text-align: right; border-bottom: 1px solid #ddd;
         font-variant-numeric: tabular-nums; vertical-align: top; }
th { vertical-align: bottom; } td { white-space: nowrap; }
th:first-child, td:first-child, .words { text-align: left; } .words { white-space: normal; }
code { font-size: .8em; background: #f2f2f0; padding: .1rem .3rem; border-radius: .2rem;
       white-space: nowrap; }
.verdict { font-weight: 600; padding: .1rem .5rem; border-radius: .3rem; }
.wide { overflow-x: auto; }
.yes { background: #d8f0dc; } .no { background: #f8dcd8; }
/* On a phone pictures and tables scroll, and names in code break. */
@media (max-width: 600px) {
  h1 { overflow-wrap: anywhere; } .wide img { max-width: none; width: 720px; }
  code { white-space: normal; overflow-wrap: anywhere; }
}
"""

# Greatest number of characters in the cells of a column that does not wrap.
_MOST_CHARACTERS = 30

type Section = tuple[str, Sequence[Finding]]


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Sizes of the experiments: samples, repetitions and simulated time.

    Attributes
    ----------
    samples : int
        Trajectories drawn for a heatmap (the paper: 10,000).
    places : int
        Number of training parts of each length in the held-out evaluation.
    tasks : tuple of str
        Demonstrations of the held-out evaluation.
    instants : int
        Number of predictions of the next second for each training part.
    robot_duration : float
        Simulated time of wiping, s.

    Examples
    --------
    >>> from fmp_drake.experiments import QUICK
    >>> from dataclasses import replace
    >>> replace(QUICK, samples=100).samples
    100
    """

    samples: int
    places: int
    tasks: tuple[str, ...]
    instants: int
    robot_duration: float


FULL = Profile(
    samples=10_000,
    places=3,
    tasks=("polishing", "eight", "wiping"),
    instants=60,
    robot_duration=20.0,
)
QUICK = Profile(
    samples=1_000,
    places=1,
    tasks=("eight",),
    instants=15,
    robot_duration=3.0,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """Figure or table with its description, and whether the claim about it holds.

    Attributes
    ----------
    name : str
        File name of the picture, such as "fig4".
    title : str
    shows : str
        Description of the result, with its numbers.
    claim : str
        Claim of the paper or of this package; "" for none.
    agrees : bool or None
        Whether the claim holds in this run; None without a claim.
    figure : Figure or None
    table : list of rows of str, or None
        The first row is the header.

    Examples
    --------
    >>> finding = Finding(
    ...     name="table_1", title="Table I", shows="Divergences.", agrees=True
    ... )
    >>> finding.agrees
    True
    """

    name: str
    title: str
    shows: str
    claim: str = ""
    agrees: bool | None = None
    figure: "Figure | None" = None
    table: list[list[str]] | None = None


def write_report(
    folder: Path,
    *,
    sections: Sequence[Section],
    introduction: str,
    results: Mapping[str, Any],
    title: str = "Fourier movement primitives: the experiments",
    markdown: Path | None = None,
) -> None:
    """Write `report.html`, a PNG for each figure, and `results.json` into a folder.

    Text between backticks is shown as code; no text is read as HTML. If a file (.md) is
    given, the report is also written to it, with a PNG for each figure beside it.
    """
    parts = [f"<h1>{html.escape(title)}</h1><p>{_inline(introduction)}</p>"]
    parts.append(_verdicts(sections))
    for heading, findings in sections:
        parts.append(f"<h2>{html.escape(heading)}</h2>")
        parts += [_finding(folder, finding) for finding in findings]
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head><body>"
        + "\n".join(parts)
        + "</body></html>\n"
    )
    write_text(folder / "report.html", page, ExperimentError)
    write_json(folder / "results.json", results, ExperimentError)
    if markdown is not None:
        _write_markdown(markdown, sections, introduction, title)


def _write_markdown(
    path: Path, sections: Sequence[Section], introduction: str, title: str
) -> None:
    """Write a report as Markdown, with a PNG for each figure beside it."""
    lines = [f"# {title}", introduction]
    for heading, findings in sections:
        lines.append(f"## {heading}")
        for finding in findings:
            lines.append(f"### {finding.title}")
            if finding.figure is not None:
                name = f"{path.stem}_{finding.name}"
                _picture(path.parent, name, finding.figure)
                lines.append(f"![{finding.title}]({quote(name)}.png)")
            if finding.table is not None:
                lines.append(markdown_table(finding.table))
            lines.append(finding.shows)
            if finding.claim:
                verdict = "holds" if finding.agrees else "does not hold"
                lines.append(f"Claim: {finding.claim} **It {verdict}.**")
    write_text(path, "\n\n".join(lines) + "\n", ExperimentError)


def markdown_table(rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown; the first row is the header."""
    head, *others = ([cell.replace("|", "/") for cell in row] for row in rows)
    return "\n".join(
        f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *others)
    )


def _verdicts(sections: Sequence[Section]) -> str:
    return _table(
        (
            f'<a href="#{html.escape(finding.name)}">{html.escape(finding.title)}</a>',
            _verdict(finding),
        )
        for _, findings in sections
        for finding in findings
        if finding.agrees is not None
    )


def _verdict(finding: Finding) -> str:
    kind, text = ("yes", "holds") if finding.agrees else ("no", "does not hold")
    return f'<span class="verdict {kind}">{text}</span>'


def _table(rows: Iterable[Iterable[str]], tag: str = "td") -> str:
    """Return a table of cells in HTML; the first row has another tag, if given."""
    cells = [list(row) for row in rows]
    if not cells:
        return ""
    lengths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = []
    for row in cells:
        line = ""
        for cell, length in zip(row, lengths, strict=True):
            words = ' class="words"' if length > _MOST_CHARACTERS else ""
            line += f"<{tag}{words}>{cell}</{tag}>"
        lines.append(f"<tr>{line}</tr>")
        tag = "td"
    return f'<div class="wide"><table>{"".join(lines)}</table></div>'


def _finding(folder: Path, finding: Finding) -> str:
    title = html.escape(finding.title)
    parts = [f'<h3 id="{html.escape(finding.name)}">{title}</h3>']
    if finding.figure is not None:
        data = base64.b64encode(_picture(folder, finding.name, finding.figure)).decode()
        image = f'<img alt="{title}" src="data:image/png;base64,{data}">'
        parts.append(f'<div class="wide">{image}</div>')
    if finding.table is not None:
        parts.append(_table((map(_inline, row) for row in finding.table), "th"))
    parts.append(f"<p>{_inline(finding.shows)}</p>")
    if finding.claim:
        parts.append(f"<p>Claim: {html.escape(finding.claim)} {_verdict(finding)}</p>")
    return "\n".join(parts)


def _inline(text: str) -> str:
    """Return a text as HTML, with text between backticks as code."""
    return re.sub("`([^`]*)`", r"<code>\1</code>", html.escape(text))


def _picture(folder: Path, name: str, figure: "Figure") -> bytes:
    """Write a figure as PNG, and return it."""
    buffer = io.BytesIO()
    # A constrained layout beside a legend converges with the second drawing.
    figure.draw_without_rendering()
    figure.savefig(buffer, dpi=110, format="png")
    with replaced(folder / f"{name}.png", ExperimentError) as part:
        part.write_bytes(buffer.getvalue())
    return buffer.getvalue()
