"""The command line: `motionrecover recover walk.bvh -o walk.npz`.

Exit codes: 0 done, 1 no usable answer, 2 something is wrong with a file or an option, 130 interrupted.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from motionrecover import __version__, threads
from motionrecover.cli import batch, changing, demo, learned, looking, recovery, stream, terminal

_QUICKLY = "--xla_backend_extra_options=xla_cpu_disable_loop_unrolling,xla_disable_slp_vectorizer"

# Older versions of typer build on click, newer ones on a copy of it: this is the UsageError of either.
_UsageError: Any = typer.BadParameter.__mro__[1]

app = typer.Typer(context_settings={"help_option_names": ["-h", "--help"]}, pretty_exceptions_enable=False)
for command in (
    demo.demo,
    looking.info,
    looking.skeleton,
    recovery.recover,
    batch.batch,
    stream.stream,
    looking.view,
    looking.evaluate,
    changing.corrupt,
    changing.convert,
    learned.models,
    learned.train,
    learned.refine,
):
    app.command()(command)


def _version(asked: bool) -> None:
    if asked:
        print(f"motionrecover {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _start(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Recover the human motion that really happened from recordings with jitter, spikes and missing joints.

    Start with `motionrecover demo`, then `motionrecover info FILE` on a file of yours.
    """
    if context.invoked_subcommand is None:
        print(context.get_help())


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line with these arguments, or those of the process, and return the exit code."""
    if argv is None:
        # A process for one clip compiles longer than it computes: what these leave out saves a third of the compiling.
        os.environ.setdefault("XLA_FLAGS", _QUICKLY)
        os.environ.setdefault(threads.BLAS_THREADS, "1")
        # With Python's own 700, the collector goes through all modules again and again while they load: 0.15 s.
        gc.set_threshold(100_000)
    with terminal.notes():
        try:
            code = app(None if argv is None else list(argv), prog_name="motionrecover", standalone_mode=False) or 0
            sys.stdout.flush()
        except _UsageError as error:
            help_of = error.ctx.command_path if error.ctx else "motionrecover"
            code = _fail(f"{error.format_message().rstrip('.')} (see {help_of} --help)", 2)
        except (ValueError, OSError, MemoryError) as error:
            code = _fail(error, 2)
        except (KeyboardInterrupt, typer.Abort):
            code = 130
        except RuntimeError as error:
            from motionrecover.recovery import RecoveryError

            if not isinstance(error, RecoveryError):
                raise
            code = _fail(error, 1)
    if code == 130 and argv is None:
        os._exit(code)  # An ordinary exit waits for the solver, and JAX crashes while its compilation is cut off.
    if argv is None:
        gc.freeze()  # Or it goes through everything once more at exit: 0.3 s.
    return code


def _fail(error: Exception | str, code: int) -> int:
    """Say what went wrong on one line."""
    print("error:", " ".join(str(error).split()), file=sys.stderr)
    return code
