"""The options of `gcbench render`."""

# No `annotations` from the future here: tyro evaluates those of the local class.

from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal

from ...errors import ConfigError
from ..cluster import ExecutorOptions, RayWorkers
from ..runtime import command_line, parse_shard
from ..scene import STUDIO, RandomizationConfig, RenderConfig, read_config, resolve

_MOST = 1_000_000  # sequences of one run
_GROUPS = {
    "options": "--help --robot --n --out --sequences --shard --seed --frames --width --height "
               "--layers --randomize --config --workers --quiet --json",
    "cluster": "--executor --address --gpus",
    "model": "--package --root --scale --allow-missing --animation --scored-joints",
    "sequence": "--twin-of --vary --stream --keep-unobservable --samples --track-points "
                "--flow --no-visibility --device",
}
"""Options by group; those of the randomization have groups of their own."""


@dataclass(frozen=True)
class RenderOptions:
    """What `gcbench render` hands to `render_dataset`, and what it prints."""

    config: RenderConfig
    n: int | Collection[int]
    out: Path
    workers: int | RayWorkers | None
    device: str
    quiet: bool
    json: bool


def render_options(args: Sequence[str], doc: str | None) -> RenderOptions:
    """Parse the options of `gcbench render`; `doc` is the text above them in the help.

    Raises ConfigError for wrong options, SystemExit after printing the help.
    """
    import tyro

    quiet = tyro.conf.arg(help_behavior_hint="")
    ranges = RandomizationConfig()

    @dataclass(frozen=True)
    class Render(command_line.OutputOptions, ExecutorOptions, RenderConfig):
        n: int = 10
        """Number of sequences in the dataset."""
        sequences: Annotated[str, quiet] = ""
        """Numbers of the sequences to render, such as 0-9,15, in place of --n."""
        shard: Annotated[str, quiet] = ""
        """Render a share of the --n sequences, such as 3/64: those at the places 3, 67, 131, ...
        (from 0). Several machines that share the folder may render one dataset at the same time.
        auto: as the variables of Slurm, AWS Batch, Kubernetes (auto/64) or torchrun say."""
        out: Annotated[Path | None, quiet] = None
        """Folder of the dataset, or its address in object storage, such as s3://bucket/data.
        Default: data/ROBOT."""
        workers: Annotated[int | None, quiet] = None
        """Processes that render. 0: one for each core, which is the fastest and the default."""
        device: Annotated[str, quiet] = ""
        """What draws: a name that `gcbench doctor` shows (0, cuda:1, 65:00.0), gpu (any, but no
        software) or software. Default: a GPU if one works."""
        randomize: Literal["full", "none"] = "full"
        """none: a plain studio, in which only the motion, the directions of the
        lights, and the object of a kind are random."""
        config: Annotated[Path | None, quiet] = None
        """TOML or JSON file of options (any but --n, --sequences, --shard, --out, --workers,
        --executor, --address, --gpus, --device, --quiet, --json and --randomize, with _ for -),
        with tables such as `[randomization.camera]`, or a dataset.json. Options on the command
        line override the file."""
        randomization: Annotated[RandomizationConfig, tyro.conf.arg(name="")] = ranges

    is_plain = command_line.option_value(args, "--randomize") == "none"
    base = RenderConfig(randomization=STUDIO) if is_plain else RenderConfig()
    if file := command_line.option_value(args, "--config"):
        base = read_config(Path(file), base)
    names = [f.name for f in fields(RenderConfig)]
    default = Render(**{name: getattr(base, name) for name in names})
    options: Any = command_line.parse_options(args, "render", Render, doc, default, _GROUPS)
    config = resolve(RenderConfig(**{name: getattr(options, name) for name in names}))
    out = options.out or Path("data") / Path(config.robot).stem.replace(":", "-")
    n = parse_shard(options.shard, options.n) if options.shard else options.n
    if options.sequences:
        n = _numbers(options.sequences, args)
    workers = options.choose_workers(options.workers)
    if options.device and options.executor == "ray":
        raise ConfigError("--device is of this machine; with --executor ray, give --gpus")
    return RenderOptions(config, n, out, workers, options.device, options.quiet, options.json)


def _numbers(sequences: str, args: Sequence[str]) -> list[int]:
    """The numbers that --sequences lists. Raises ConfigError if another option counts them, too."""
    for option in ("--shard", "--n"):
        if command_line.option_value(args, option) is not None:
            raise ConfigError(f"{option} and --sequences exclude each other; give one of them")
    ranges = command_line.parse_ranges(sequences)
    if sum(map(len, ranges)) > _MOST:
        raise ConfigError(f"--sequences {sequences[:60]}: more than {_MOST} at once")
    return sorted({*chain(*ranges)})
