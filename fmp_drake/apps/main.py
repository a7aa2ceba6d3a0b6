"""The command `fmp-drake`."""

import importlib
import logging
import sys
from collections.abc import Sequence

import click

from fmp_drake import __version__
from fmp_drake.errors import FmpError

# The module `fmp_drake.apps.wipe` has the command `wipe`, and so on.
_COMMANDS = {
    "arm": "Simulate an arm that speaks a real one's LCM messages, to try against.",
    "check": "Tell whether the arm can follow a skill on a board, and what would help.",
    "inspect": "Tell what is in recordings, and whether they can be learned.",
    "learn": "Learn a skill from DEMONSTRATIONS (tables, bags ...) and write it to a "
    "file.",
    "record": "Record a demonstration: a simulated person guides the arm over the "
    "board.",
    "reproduce": "Rerun the paper's experiments and write a report with figures and "
    "tables.",
    "scenarios": "List the scenarios that come with the package.",
    "teach": "Teach the arm with the mouse: drag it on the page, press learn, and it "
    "wipes on.",
    "video": "Turn FRAMES, the .tar that the page's recorder saves, into the film OUT.",
    "worlds": "Draw worlds from SOURCE, run them, and report what went wrong in which.",
    "wipe": "Learn whiteboard wiping from a demonstration and wipe the board.",
}


class _LazyGroup(click.Group):
    """A group that imports a command only when it is run, because that takes seconds."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the commands' names."""
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; what it runs uses one thread of BLAS."""
        if cmd_name not in _COMMANDS:
            return None
        module = importlib.import_module(f"fmp_drake.apps.{cmd_name}")
        from threadpoolctl import threadpool_limits

        # The matrices of a control step are small: more threads would only spin.
        ctx.with_resource(threadpool_limits(limits=1))
        command: click.Command = getattr(module, cmd_name)
        return command

    def format_commands(
        self,
        ctx: click.Context,  # noqa: ARG002
        formatter: click.HelpFormatter,
    ) -> None:
        """Write one line about each command, without importing any."""
        with formatter.section("Commands"):
            formatter.write_dl(list(_COMMANDS.items()))


class _StderrHandler(logging.Handler):
    """Writes each record as one plain line to stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record."""
        print(f"fmp-drake: {record.getMessage()}", file=sys.stderr)


_HANDLER = _StderrHandler()


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="fmp-drake")
def app() -> None:
    """Fourier movement primitives for Drake: teach rhythmic skills, play them."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; bad input ends with one line and exit code 2."""
    # Meshcat's address is printed where it is of use. Drake sets its logger's level anew
    # when it is imported, later.
    logging.getLogger("drake").addFilter(_is_warning)
    logger = logging.getLogger("fmp_drake")
    logger.setLevel(logging.INFO)
    logger.addHandler(_HANDLER)
    # Drake gives the root logger a handler of its own, which would say all again.
    logger.propagate = False
    try:
        app.main(args=arguments, prog_name="fmp-drake", standalone_mode=False)
    except FmpError as error:
        _fail(str(error), 2)
    except click.exceptions.NoArgsIsHelpError as error:
        print(error.format_message())
        sys.exit(error.exit_code)
    except click.ClickException as error:
        _fail(error.format_message(), error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        _fail("stopped.", 130)
    except SystemError as error:
        if not _is_interrupt(error):
            raise
        _fail("stopped.", 130)
    except OSError as error:
        _fail(f"{error.filename or ''}: {error.strerror}".lstrip(": "), 2)


def _is_interrupt(error: BaseException | None) -> bool:
    """Return whether it came of Ctrl-C, while compiled code was fetched from its cache."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _is_warning(record: logging.LogRecord) -> bool:
    return record.levelno >= logging.WARNING


def _fail(message: str, code: int) -> None:
    print(f"fmp-drake: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(code)


if __name__ == "__main__":
    main()
