"""Runs cases of each kind in turn and collects what is found."""

from __future__ import annotations

import re
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

from . import configuration, data, models
from .actions import check_action, check_disk
from .cases import Case, write
from .corpus import CORPUS
from .faults import Fault
from .rng import CaseRng
from .sandbox import Outcome, Sandbox, adopt_orphans, run
from .shared_process import SharedProcess, may_share
from .warm import load_everything

KINDS: dict[str, Callable[[CaseRng], Case]] = {
    "urdf": models.urdf,
    "mesh": models.mesh,
    "gltf": models.gltf,
    "dataset": data.dataset,
    "predictions": data.predictions,
    "results": data.results,
    "configuration": configuration.configuration,
}


OWN = 10
"""Of so many cases one runs in processes of its own, as the command line does."""


@dataclass(frozen=True)
class Finding:
    """A case that did what no input may make the command line do."""

    kind: str
    seed: int
    index: int
    command: str
    problem: str

    def __str__(self) -> str:
        return (
            f"python -m tests.fuzz {self.kind} --seed {self.seed} --index {self.index}"
            f"  # {self.command}: {self.problem}"
        )


@dataclass
class Campaign:
    """What was run and found."""

    counts: Counter[str] = field(default_factory=Counter)
    accepted: Counter[str] = field(default_factory=Counter)
    """Cases whose commands all succeeded."""
    findings: list[Finding] = field(default_factory=list)


def make(kind: str, seed: int, index: int) -> Case:
    """The case of an index."""
    return KINDS[kind](CaseRng(kind, seed, index))


def attempt(
    case: Case, box: Sandbox, shared: SharedProcess | None = None
) -> list[tuple[str, Outcome]]:
    """Run the commands of a case until one fails; in the shared process those that may be there."""
    box.reset()
    write(case.files, box)
    done: list[tuple[str, Outcome]] = []
    for command in case.commands:
        runs = shared.run if shared and may_share(command) else run
        done.append((" ".join(command.argv), runs(command, box)))
        if done[-1][1].code or done[-1][1].problems:
            break
    return done


def campaign(
    kinds: Sequence[str],
    seed: int,
    first: int,
    count: int | None,
    seconds: float,
    tell: Callable[[Finding], None] = lambda finding: None,
) -> Campaign:
    """Run `count` cases of each kind from `first` on, in turn; without a count, until `seconds`."""
    start()
    out, index, end = Campaign(), first, time.monotonic() + seconds
    with Sandbox.temporary() as box, closing(SharedProcess()) as shared:
        while index - first < count if count is not None else True:
            for kind in kinds:
                if count is None and time.monotonic() > end:
                    return out
                try:
                    case = make(kind, seed, index)
                    done = attempt(case, box, shared if index % OWN else None)
                    if index % OWN and _problems(done):
                        done = alone if _problems(alone := attempt(case, box)) else _shared(done)
                except KeyboardInterrupt:
                    return out
                out.counts[kind] += 1
                out.accepted[kind] += not done[-1][1].code
                for command, outcome in done:
                    for problem in outcome.problems:
                        out.findings.append(Finding(kind, seed, index, command, problem))
                        tell(out.findings[-1])
            index += 1
            if index % 100 == 0:
                print(f"{index} cases of each kind", file=sys.stderr, flush=True)
    return out


def _problems(done: list[tuple[str, Outcome]]) -> bool:
    return any(outcome.problems for _, outcome in done)


def _shared(done: list[tuple[str, Outcome]]) -> list[tuple[str, Outcome]]:
    """Mark problems that a process of its own does not have."""
    return [
        (command, replace(o, problems=tuple(f"after other inputs: {p}" for p in o.problems)))
        for command, o in done
    ]


def show(kind: str, seed: int, index: int) -> int:
    """Run one case and print what it is and what each command said."""
    start()
    case, problems = make(kind, seed, index), 0
    print(*(f"changed {step}" for step in case.steps), sep="\n")
    with Sandbox.temporary() as box:
        for command, outcome in attempt(case, box):
            print(f"$ gcbench {command}\n{outcome.stdout}{outcome.stderr}".rstrip())
            print(f"exit code {outcome.code}, {outcome.seconds:.1f} s, {outcome.memory:.0f} MiB")
            print(*(f"PROBLEM {problem}" for problem in outcome.problems), sep="\n")
            problems += len(outcome.problems)
    return 1 if problems else 0


def check_corpus(names: Sequence[str]) -> dict[str, list[str]]:
    """What is wrong with named cases: problems, and ends that are not the expected ones."""
    start()
    wrong: dict[str, list[str]] = {}
    with Sandbox.temporary() as box:
        for name in names or CORPUS:
            done = attempt(CORPUS[name].build(), box)
            last = done[-1][1]
            problems = [problem for _, outcome in done for problem in outcome.problems]
            said = (last.stderr + last.stdout).strip()
            wanted = CORPUS[name]
            if wanted.harm:
                seen = any(re.search(wanted.harm, problem) for problem in [*problems, said])
                problems = [] if seen else ["is not seen"]
            elif not last.code and not wanted.accepted:
                problems.append("is accepted")
            elif last.code and not (wanted.refused and re.search(wanted.refused, said)):
                problems.append(f"is refused: {said[-300:]}")
            wrong[name] = problems
    return wrong


def check_faults(name: str, faults: tuple[Fault, ...], at: int) -> int:
    """Print what goes wrong when faults happen while a command runs; the number of lines."""
    start()
    lines = 0
    with Sandbox.temporary() as box:
        for line in check_action(name, box, faults, at) if faults else check_disk(name, box):
            print(line, flush=True)
            lines += 1
    return lines


def keep(kind: str, seed: int, index: int, folder: Path) -> int:
    """Write the files of one case."""
    box = Sandbox(folder.resolve())
    box.reset()
    case = make(kind, seed, index)
    write(case.files, box)
    print(f"cd {box.work}", *(f"gcbench {' '.join(c.argv)}" for c in case.commands), sep="\n")
    return 0


_started = False


def start() -> None:
    """Prepare this process to fork commands."""
    global _started
    if not _started:
        _started = True
        sys.setrecursionlimit(max(sys.getrecursionlimit(), 3000))
        load_everything()
        adopt_orphans()
