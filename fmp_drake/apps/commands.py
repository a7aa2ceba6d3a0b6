"""The commands of `fmp-drake`, each imported only when it runs."""

import ast
import importlib
import logging
import sys
from pathlib import Path

import click

from fmp_drake import __version__
from fmp_drake.apps import terminal

# The module `fmp_drake.apps.wipe` has the command `wipe`, and so on.
_COMMANDS = (
    "arm",
    "benchmark",
    "check",
    "inspect",
    "learn",
    "record",
    "reproduce",
    "robots",
    "scenarios",
    "teach",
    "video",
    "worlds",
    "wipe",
)


def _summary(name: str) -> str:
    """Return the first line of a command's docstring, without importing its module."""
    module = ast.parse(Path(__file__).with_name(f"{name}.py").read_text("utf-8"))
    functions = {f.name: f for f in module.body if isinstance(f, ast.FunctionDef)}
    return (ast.get_docstring(functions[name]) or "").partition("\n")[0]


class _LazyGroup(click.Group):
    """Group that imports a command only when it runs, because an import takes seconds."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the commands' names."""
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command, and limit BLAS to one thread."""
        if cmd_name not in _COMMANDS:
            return None
        module = importlib.import_module(f"fmp_drake.apps.{cmd_name}")
        import matplotlib
        from threadpoolctl import threadpool_limits

        # Pictures do not depend on the user's settings.
        matplotlib.rcdefaults()
        # The matrices of a control step are small: more threads would be slower.
        ctx.with_resource(threadpool_limits(limits=1))
        command: click.Command = getattr(module, cmd_name)
        terminal.begin_command()
        return command

    def format_commands(
        self,
        ctx: click.Context,  # noqa: ARG002
        formatter: click.HelpFormatter,
    ) -> None:
        """Write one line about each command, without importing any."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, _summary(name)) for name in _COMMANDS])
        with formatter.section("Start with"):
            formatter.write_text("fmp-drake wipe       watch a simulated arm")
            formatter.write_text("fmp-drake teach      guide it yourself")
            formatter.write_text("fmp-drake wipe -h    examples and options")


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="fmp-drake")
def app() -> None:
    """Fourier movement primitives for Drake: teach rhythmic skills, play them."""


class _StderrHandler(logging.Handler):
    """Handler that writes each record as one plain line to stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record."""
        print(f"fmp-drake: {record.getMessage()}", file=sys.stderr)


_HANDLER = _StderrHandler()


def log_to_stderr() -> None:
    """Write log messages of the package and warnings of Drake to stderr."""
    # Drake logs Meshcat's address, which the commands print themselves. A filter, because
    # Drake resets the level of its logger when it is imported.
    drake = logging.getLogger("drake")
    drake.addFilter(lambda record: record.levelno >= logging.WARNING)
    logger = logging.getLogger("fmp_drake")
    logger.setLevel(logging.INFO)
    logger.addHandler(_HANDLER)
    # Drake adds a handler to the root logger, which would repeat each message.
    logger.propagate = False
