"""The command line: dispatch to the commands, help, errors and exit codes.

The commands of each room are in its `commands.py`: the arguments of a function are the options of
its command, and its docstring is their help. It calls the public API, and returns what it prints
(text, or a record that is printed as JSON) and its exit code. Parts of the package are imported
when a command runs, so that `gcbench --help` answers at once.
"""

import faulthandler
import os
import signal
import sys
from collections.abc import Callable, Sequence
from io import TextIOWrapper
from pathlib import Path

import gcbench as gb
from gcbench.benchmark import commands as benchmark
from gcbench.errors import printable, suggestion
from gcbench.gcpose import commands as gcpose
from gcbench.renderer import commands as renderer
from gcbench.robots import commands as robots

Command = Callable[..., tuple[object, int]]
GROUPS: dict[str, dict[str, Command]] = {
    "make data": {
        "render": renderer.render, "submit": renderer.submit, "export": renderer.export,
        "robots": robots.robots, "robots fetch": robots.fetch,
    },
    "look at data": {"show": renderer.show, "verify": renderer.verify},
    "evaluate methods": {
        "eval": benchmark.evaluate, "score": benchmark.score, "report": benchmark.report,
        "publish": benchmark.publish, "methods": benchmark.methods, "suites": benchmark.suites,
    },
    "estimate motion": {"estimate": gcpose.estimate},
    "more": {
        "doctor": renderer.doctor, "train flow": gcpose.train_flow,
        "train foreground": gcpose.train_foreground, "train people": gcpose.train_people,
        "train screwnet": gcpose.train_screwnet, "train abbatematteo": gcpose.train_abbatematteo,
        "train dustnet": gcpose.train_dustnet, "train craves": gcpose.train_craves,
        "craves-images": gcpose.craves_images,
    },
}
COMMANDS = {name: command for group in GROUPS.values() for name, command in group.items()}
HELP = """\
gcbench: synthetic videos of articulated objects with exact ground truth, and their benchmark.

usage: gcbench COMMAND [OPTIONS]
{commands}
examples:
  gcbench render --robot ur5 --n 20 --seed 7
  gcbench show data/ur5 --open
  gcbench verify data/ur5
  gcbench eval --method gcpose --data data/ur5
  gcbench estimate door.mp4 --fov 42 --axes 0 -1 0
  source <(gcbench --completion bash)        # or zsh, tcsh

`gcbench COMMAND --help` explains a command. `gcbench --version` prints the version.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit code.

    0: success. 1: `verify` found an error, or no estimate of `eval` succeeded. 2: an error message,
    or nothing can render (`doctor`). 130: Ctrl-C. 141: the reader of the output has closed it.
    143: SIGTERM (`train` saves its state first).
    """
    if argv is None and sys.stderr is not None:
        faulthandler.enable()  # says where a library crashed
    args = list(sys.argv[1:] if argv is None else argv)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # what its encoding does not have
    if not args or args[0] in ("-h", "--help", "help"):
        lines: list[str] = []
        for title, commands in GROUPS.items():
            lines += ["", f"{title}:"]
            lines += [f"  {k:18} {(f.__doc__ or k).splitlines()[0]}" for k, f in commands.items()]
        print(HELP.format(commands="\n".join([*lines, ""])), end="")
        return 0
    if args[0] == "--version":
        return _say(f"gcbench {gb.__version__}")
    try:
        words = 2 if " ".join(args[:2]) in COMMANDS else 1
        code = _run(" ".join(args[:words]), args[words:])
        sys.stdout.flush()  # raises BrokenPipeError here, if at all
        return code
    except KeyboardInterrupt as stop:
        from gcbench.renderer.runtime import TerminationError

        print("gcbench: stopped; run the same command again to continue", file=sys.stderr)
        return 128 + (signal.SIGTERM if isinstance(stop, TerminationError) else signal.SIGINT)
    except BrokenPipeError:  # as in `gcbench robots | head -1`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except OSError as error:  # a name that is too long, a full disk, a folder without permission
        where = f"{error.filename}: " if error.filename else ""
        problem = printable(f"{where}{error.strerror or error}")
    except gb.GcbenchError as error:
        problem = str(error)
    print(f"gcbench: {problem}", file=sys.stderr)
    return 2


def _run(name: str, args: Sequence[str]) -> int:
    """Run a command, print what it returns, and return its exit code."""
    from gcbench.renderer.runtime import command_line

    if name == "--completion":
        return _say(command_line.completion_script(COMMANDS, " ".join(args)))
    function = COMMANDS.get(name)
    if function is None and (within := [k for k in COMMANDS if k.startswith(f"{name} ")]):
        if args and args[0] in ("-h", "--help"):
            lines = [f"  {k:18} {(COMMANDS[k].__doc__ or k).splitlines()[0]}" for k in within]
            return _say("\n".join([f"usage: gcbench {name} NAME [OPTIONS]", "", *lines]))
        given = " ".join([name, *args[:1]])
        raise gb.ConfigError(f"no command {given!r}; there are {', '.join(within)}")
    if function is None:
        known = f"{suggestion(name, COMMANDS)}; there are {', '.join(COMMANDS)}"
        raise gb.ConfigError(f"no command {name!r}{known}")
    output, code = command_line.run_command(name, function, args)
    is_text = isinstance(output, str | Path)
    _say(output if is_text else command_line.to_json(output))
    return code


def _say(output: object) -> int:
    """Print text, which may hold names of any kind, and return the exit code of success."""
    print(printable(str(output)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
