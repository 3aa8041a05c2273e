"""The fuzzers' command line.

python -m tests.fuzz urdf --seed 17 --index 4211     one case again, with what it was and said
python -m tests.fuzz urdf mesh --count 1000          the first thousand cases of two kinds
python -m tests.fuzz --minutes 60                    all kinds in turn, until the time is over
python -m tests.fuzz --corpus a_pipe_as_run          named cases (all without a name), as JSON
python -m tests.fuzz --faults render --fault kill    kill a command at every change of a file
python -m tests.fuzz --kills node --count 20         kill nodes of Ray at random moments
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from .actions import ACTIONS, FAULTS
from .campaign import KINDS, campaign, check_corpus, check_faults, keep, show
from .kills import KILLS, check_kills


def main() -> int:
    parser = argparse.ArgumentParser(
        "python -m tests.fuzz",
        description=(__doc__ or "").strip(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"default: {' '.join(KINDS)}")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--index", type=int, help="this case only")
    parser.add_argument("--first", type=int, default=0, help="index of the first case")
    parser.add_argument("--count", type=int, help="cases of each kind")
    parser.add_argument("--minutes", type=float, default=1.0, help="limit without --count")
    parser.add_argument("--keep", type=Path, help="with --index: keep the files in this folder")
    parser.add_argument("--corpus", action="store_true", help="check named cases")
    parser.add_argument("--faults", choices=ACTIONS, help="kill a command, or fail its disk")
    parser.add_argument("--fault", choices=(*FAULTS, "disk"), help="default: all; disk: a real one")
    parser.add_argument("--at", type=int, default=0, help="number of the change; default: all")
    parser.add_argument(
        "--kills",
        choices=[*KILLS, "all"],
        help="kill what renders, or stop its server, at --count random moments (default 20)",
    )
    parser.add_argument("--sequences", type=int, default=24, help="with --kills: of a dataset")
    options = parser.parse_args()
    if options.kills:
        kinds = [*KILLS] if options.kills == "all" else [options.kills]
        return kill(kinds, options.count or 20, options.seed, options.sequences)
    if options.faults:
        faults = tuple(fault for fault in FAULTS if options.fault in (None, fault))
        return 1 if check_faults(options.faults, faults, options.at) else 0
    if options.corpus:
        print(json.dumps(check_corpus(options.kinds), indent=1))
        return 0
    kinds = options.kinds or [*KINDS]
    if unknown := [kind for kind in kinds if kind not in KINDS]:
        parser.error(f"no kind {unknown[0]}; there are {', '.join(KINDS)}")
    if options.keep:
        return keep(kinds[0], options.seed, options.index or 0, options.keep)
    if options.index is not None:
        return show(kinds[0], options.seed, options.index)
    done = campaign(
        kinds,
        options.seed,
        options.first,
        options.count,
        60 * options.minutes,
        lambda finding: print(finding, flush=True),
    )
    for kind, count in done.counts.items():
        print(
            f"{kind}: {count} cases, {done.accepted[kind]} of them accepted, "
            f"{len([f for f in done.findings if f.kind == kind])} findings, seed {options.seed}"
        )
    return 1 if done.findings else 0


def kill(kinds: list[str], count: int, seed: int, sequences: int) -> int:
    """Print what kills did, and what is wrong; return the exit code."""
    wrong = 0
    for record in check_kills(kinds, count, seed, sequences):
        print(
            f"{record.kind}: {record.kills} kills of {record.commands} commands, {record.results} "
            f"results compared, at most {record.longest:.1f} s without progress, "
            f"{len(record.problems)} problems, seed {seed}",
            *record.problems,
            sep="\n    ",
            flush=True,
        )
        wrong += len(record.problems)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
