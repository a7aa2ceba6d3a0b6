"""Follow the README, as a newcomer would: ``make readme``.

The wheel of this checkout is installed into an environment of its own, beside nothing else
in an empty folder. There every Python block and every command of the README is run, as it
stands, in their order. What begins with ``make`` is for a checkout, and not run here.
"""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urljoin

REPOSITORY = Path(__file__).resolve().parents[1]
README = REPOSITORY / "README.md"
PAGE = re.compile(r"\bit at (http://localhost:[^\s;]+)")
UNATTENDED = {
    "stdin": subprocess.DEVNULL,
    "stdout": subprocess.PIPE,
    "stderr": subprocess.STDOUT,
    "text": True,
}
WRITTEN = re.compile(r"--(?:html|video|log|plot|graphviz|report|out) (\S+)")


def steps(text: str) -> Iterator[tuple[str, str]]:
    """Yield what is to be run, ("python", a program) or ("sh", one command)."""
    for language, block in re.findall(
        r"^```(python|sh)\n(.*?)^```", text, re.DOTALL | re.MULTILINE
    ):
        if language == "python":
            yield language, block
            continue
        for line in block.splitlines():
            command = line.split(" #")[0].strip()
            if command and not command.startswith("make "):
                yield language, command


def opens_page(command: str) -> bool:
    """Return whether a command shows a page, and goes on until it is closed."""
    return bool(re.match(r"fmp-drake (wipe|teach)\b", command)) and (
        "--headless" not in command
    )


def watch(url: str) -> None:
    """Open a page, and wait until its panel shows that the simulation runs."""
    with urllib.request.urlopen(url, timeout=600) as page:
        assert b"<html" in page.read().lower()
    with urllib.request.urlopen(urljoin(url, "/panel"), timeout=600) as panel:
        for line in panel:
            shown = json.loads(line.partition(b":")[2] or "{}")
            if shown.get("mode") == "teaching" or (shown.get("time") or 0) > 0.5:
                return
    raise SystemExit(f"{url} shows nothing")


def visit(command: str, folder: Path, env: dict[str, str]) -> str:
    """Run a command until its page shows a run, end it with Ctrl-C, return what it printed."""
    with subprocess.Popen(
        ["bash", "-c", f"exec {command}"],
        cwd=folder,
        env=env,
        **UNATTENDED,
    ) as process:
        said = []
        for line in process.stdout:
            said.append(line)
            found = PAGE.search(line)
            if found:
                watch(found[1])
                process.send_signal(signal.SIGINT)
                said += process.stdout.readlines()
                # Nobody has to wonder which address is meant.
                assert sum("http" in each for each in said) == 1, said
                return "".join(said)
    raise SystemExit(f"{command} showed no page:\n{''.join(said)}")


def run(language: str, what: str, folder: Path, env: dict[str, str]) -> str:
    """Run one step to its end and return what it printed."""
    if language == "sh" and opens_page(what):
        return visit(what, folder, env)
    words = ["python", "-c", what] if language == "python" else ["bash", "-c", what]
    done = subprocess.run(
        words,
        cwd=folder,
        env=env,
        **UNATTENDED,
        check=False,
    )
    if done.returncode != 0:
        raise SystemExit(f"ended with {done.returncode}:\n{done.stdout}")
    return done.stdout


def main() -> None:
    """Build the wheel, make the environment, do what the README says."""
    text = README.read_text(encoding="utf-8")
    # What a shell starts in the background ignores it, and so would all that starts here.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with tempfile.TemporaryDirectory(prefix="fmp_drake_readme_") as temporary:
        folder, environment = Path(temporary) / "empty", Path(temporary) / "environment"
        folder.mkdir()
        build = [sys.executable, "-m", "build", "--wheel", "--no-isolation"]
        subprocess.run(
            [*build, "--outdir", folder, REPOSITORY],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        subprocess.run([sys.executable, "-m", "venv", environment], check=True)
        env = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
        env["PATH"] = f"{environment / 'bin'}{os.pathsep}{env['PATH']}"
        # No screen here, and the versions of other packages that the tests have.
        env["MPLBACKEND"] = "Agg"
        env["PIP_CONSTRAINT"] = str(REPOSITORY / "constraints.txt")
        env["PIP_DISABLE_PIP_VERSION_CHECK"] = "1"
        for language, what in steps(text):
            print(f"{what.strip().splitlines()[0]:70}", end="", flush=True)
            begun = time.perf_counter()
            said = run(language, what, folder, env)
            print(f"{time.perf_counter() - begun:6.1f} s", flush=True)
            if "Traceback" in said:
                raise SystemExit(said)
            if language == "sh":
                for name in WRITTEN.findall(what):
                    assert (folder / name).exists(), f"{what} wrote no {name}"
        where = run(
            "python", "import fmp_drake; print(fmp_drake.__file__)", folder, env
        )
        assert Path(where.strip()).is_relative_to(environment.resolve()), where
    print("Everything in the README works, from the wheel alone.")


if __name__ == "__main__":
    main()
