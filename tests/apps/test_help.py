"""Facts about the command line before a command runs."""

import logging
import subprocess
import sys

import pytest
from click import Context
from threadpoolctl import threadpool_info

from fmp_drake.apps.main import app

# Imported by the commands, and slow.
HEAVY = "{'numpy', 'pydrake', 'matplotlib', 'sklearn', 'numba', 'rich'}"


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_help_and_version_import_no_command(option):
    code = f"""
import sys
from fmp_drake.apps.main import main
main(["{option}"])
assert not {HEAVY} & set(sys.modules)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert "fmp-drake" in done.stdout or "wipe" in done.stdout


def test_help_says_of_each_command_what_the_command_says_of_itself(command):
    said = " ".join(command("--help").out.split())
    with Context(app) as context:
        for name in app.list_commands(context):
            explained = app.get_command(context, name).help
            summary = " ".join(explained.split("\n\n")[0].split())
            assert f" {name} {summary}" in said


def test_unknown_command_is_refused(refused):
    assert "mop" in refused("mop")


def test_a_command_computes_with_one_thread_of_blas():
    with Context(app) as context:
        app.get_command(context, "learn")
        assert {pool["num_threads"] for pool in threadpool_info()} == {1}


def test_what_the_package_logs_is_one_line_on_stderr(command, capsys):
    command("--help")
    command("--help")
    logging.getLogger("fmp_drake").info("compiling")
    assert capsys.readouterr().err == "fmp-drake: compiling\n"
