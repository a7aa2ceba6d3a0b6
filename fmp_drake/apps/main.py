"""The command `fmp-drake`."""

import logging
import sys
from collections.abc import Sequence

import click
from threadpoolctl import threadpool_limits

from fmp_drake import __version__
from fmp_drake.apps.learn import learn
from fmp_drake.apps.record import record
from fmp_drake.apps.reproduce import reproduce
from fmp_drake.apps.scenarios import scenarios
from fmp_drake.apps.video import video
from fmp_drake.apps.wipe import wipe
from fmp_drake.errors import FmpError


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="fmp-drake")
def app() -> None:
    """Fourier movement primitives for Drake: teach rhythmic skills, play them."""


for command in (wipe, scenarios, learn, record, reproduce, video):
    app.add_command(command)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; bad input ends with one line and exit code 2."""
    # Meshcat's address is printed where it is of use.
    logging.getLogger("drake").setLevel(logging.WARNING)
    try:
        # The matrices of a control step are small: BLAS threads would only spin.
        with threadpool_limits(limits=1):
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
    except OSError as error:
        _fail(f"{error.filename or ''}: {error.strerror}".lstrip(": "), 2)


def _fail(message: str, code: int) -> None:
    print(f"fmp-drake: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(code)


if __name__ == "__main__":
    main()
