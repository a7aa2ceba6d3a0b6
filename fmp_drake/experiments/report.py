"""The report: one HTML file with every figure inside, the figures, and the numbers."""

import base64
import html
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.finding import Finding
from fmp_drake.primitives.data.files import replaced, write_text

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 70rem;
       margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.8rem; } h2 { margin-top: 3rem; border-bottom: 1px solid #ccc; }
img { max-width: 100%; } table { border-collapse: collapse; }
th, td { padding: .25rem .75rem; text-align: right; border-bottom: 1px solid #ddd; }
th:first-child, td:first-child { text-align: left; }
.verdict { font-weight: 600; padding: .1rem .5rem; border-radius: .3rem; }
.yes { background: #d8f0dc; } .no { background: #f8dcd8; }
"""

Section = tuple[str, Sequence[Finding]]


def write_report(
    folder: Path,
    *,
    sections: Sequence[Section],
    introduction: str,
    results: Mapping[str, Any],
) -> None:
    """Write `report.html`, a PNG for each figure, and `results.json`."""
    parts = [
        f"<h1>Fourier movement primitives: the experiments</h1><p>{introduction}</p>"
    ]
    parts.append(_verdicts(sections))
    for title, findings in sections:
        parts.append(f"<h2>{html.escape(title)}</h2>")
        parts += [_finding(folder, finding) for finding in findings]
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f"<title>FMP experiments</title><style>{_STYLE}</style></head><body>"
        + "\n".join(parts)
        + "</body></html>\n"
    )
    write_text(folder / "report.html", page, ExperimentError)
    write_text(
        folder / "results.json", json.dumps(results, indent=2) + "\n", ExperimentError
    )


def _verdicts(sections: Sequence[Section]) -> str:
    judged = [f for _, group in sections for f in group if f.agrees is not None]
    return _table(
        (f'<a href="#{f.name}">{html.escape(f.title)}</a>', _verdict(f)) for f in judged
    )


def _verdict(finding: Finding) -> str:
    kind, text = ("yes", "holds") if finding.agrees else ("no", "does not hold")
    return f'<span class="verdict {kind}">{text}</span>'


def _table(rows: Iterable[Iterable[str]], tag: str = "td") -> str:
    """Return a table of cells that are HTML already; the tag is that of row 1."""
    lines = []
    for row in rows:
        lines.append("".join(f"<{tag}>{cell}</{tag}>" for cell in row))
        tag = "td"
    return "<table>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"


def _finding(folder: Path, finding: Finding) -> str:
    title = html.escape(finding.title)
    parts = [f'<h3 id="{finding.name}">{title}</h3>']
    if finding.figure is not None:
        buffer = io.BytesIO()
        finding.figure.savefig(buffer, dpi=110, format="png")
        with replaced(folder / f"{finding.name}.png", ExperimentError) as part:
            part.write_bytes(buffer.getvalue())
        data = base64.b64encode(buffer.getvalue()).decode()
        parts.append(f'<img alt="{title}" src="data:image/png;base64,{data}">')
    if finding.table is not None:
        parts.append(_table((map(html.escape, row) for row in finding.table), "th"))
    parts.append(f"<p>{html.escape(finding.shows)}</p>")
    if finding.claim:
        parts.append(f"<p>Claim: {html.escape(finding.claim)} {_verdict(finding)}</p>")
    return "\n".join(parts)
