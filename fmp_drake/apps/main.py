"""The command `fmp-drake`."""

import errno
import os
import re
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmp_drake.apps import terminal

if TYPE_CHECKING:
    import click


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; bad input ends with one line and exit code 2.

    Ctrl-C ends it with one line and exit code 130, SIGTERM with 143, SIGHUP with 129.
    """
    with terminal.interrupts():
        try:
            message, code = _run(arguments)
            stopped = terminal.exit_code(None)
        except BaseException as error:
            message, stopped = "", terminal.exit_code(error)
            if stopped is None:
                raise
        if stopped is not None:
            if not (terminal.is_noted() and message):
                message = terminal.MESSAGE
            code = stopped
        if message and sys.stderr is not None:
            with suppress(OSError):  # The terminal may be closed.
                print(" ".join(message.split()), file=sys.stderr)
    if code:
        sys.exit(code)


def _run(arguments: Sequence[str] | None) -> tuple[str, int]:
    """Run a command, and return an error message and the exit code."""
    # No window is opened, whatever backend a notebook has set for its processes.
    os.environ["MPLBACKEND"] = "agg"
    # Nothing is imported before interrupts are handled.
    import click

    from fmp_drake.apps.commands import app, log_to_stderr
    from fmp_drake.errors import FmpError

    log_to_stderr()
    if isinstance(sys.stdout, TextIOWrapper):  # Names may have letters that it lacks.
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        app.main(args=arguments, prog_name="fmp-drake", standalone_mode=False)
    except FmpError as error:
        return f"fmp-drake: {error}", 2
    except click.exceptions.NoArgsIsHelpError as error:
        print(error.format_message())
        return "", error.exit_code
    except click.ClickException as error:
        hint = _usage_hint(error)
        return f"fmp-drake: {error.format_message()}{hint}", error.exit_code
    except click.Abort:
        return terminal.MESSAGE, 130
    except OSError as error:
        reason = f"{error.filename or ''}: {error.strerror or error}".lstrip(": ")
        if not error.filename:
            reason += _place_hint(error)
        return f"fmp-drake: {reason}", 2
    return "", 0


def _place_hint(error: OSError) -> str:
    """Return a hint for an error that names no file."""
    try:
        os.getcwd()
    except FileNotFoundError:
        return " (the current folder was deleted)"
    if error.errno not in (errno.ENOSPC, errno.EFBIG, errno.EDQUOT):
        return ""
    with suppress(OSError):  # A full disk has no folder for temporary files.
        return f" (temporary files are in {tempfile.gettempdir()})"
    return ""


def _usage_hint(error: "click.ClickException") -> str:
    """Return a hint for somebody who does not know a command, or its options."""
    context: Any = getattr(error, "ctx", None)
    if context is None:
        return ""
    message, command = error.format_message(), context.command
    if message.startswith("No such command"):
        return f" The commands are: {', '.join(command.list_commands(context))}."
    surplus = re.fullmatch(r".*extra argument \((\S+)\)", message)
    if surplus is not None:
        suffix, names = Path(surplus[1]).suffix, {p.name for p in command.params}
        if suffix in ("", ".yaml", ".yml") and "scenario" in names:
            from fmp_drake.station.robots.robot import ListRobots  # Slow to import.

            option = "--robot" if surplus[1] in ListRobots() else "--scenario"
            return f"; did you mean {option} {surplus[1]}?"
        if suffix and {"demonstrations", "scenario"} <= names:
            option = "--skill" if suffix == ".npz" else "--demo"
            return f"; did you mean {option} {surplus[1]}?"
    end = "" if message.endswith((".", "?", "?)")) else "."
    return f"{end} See {context.command_path} -h."


if __name__ == "__main__":
    main()
