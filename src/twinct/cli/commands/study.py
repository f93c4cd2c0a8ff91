"""The command that runs a study."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from twinct.cli.arguments import Flag
from twinct.cli.progress import on_terminal
from twinct.core.errors import InputError
from twinct.core.foreign_text import counted, shortened
from twinct.core.memory import if_little
from twinct.report.template import duration
from twinct.study import DryRun, Tally, merge_study, run_study
from twinct.study import dry_run as preview

_LINE_EVERY_S = 30.0
_MOST_SHOWN = 40


def study(
    file: Annotated[
        tyro.conf.Positional[Path],
        tyro.conf.arg(
            metavar="STUDY", help="Study file (YAML), such as examples/studies/relaxation.yaml."
        ),
    ],
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    address: Annotated[str | None, tyro.conf.arg(metavar="auto|local|HOST:PORT")] = None,
    jobs: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    resume: Flag = False,
    retry_failed: Flag = False,
    dry_run: Flag = False,
    time: Flag = False,
    shard: Annotated[str | None, tyro.conf.arg(metavar="I/N")] = None,
    merge: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="DIR")] = (),
) -> None:
    """Run a study: many trials of one scenario, which share their common steps.

    Writes journal.jsonl, results.parquet and study.html into DIR.

    Args:
        out: Folder for the results; --resume continues or extends the study in it.
        address: Address of Ray; local starts Ray on this machine. Default: local processes.
        jobs: Trials that run at a time on this machine (default: as many as its threads allow).
        resume: Resume an interrupted study, or extend one.
        retry_failed: With --resume, try failed trials again, too.
        dry_run: Only list the trials and their expected cost.
        time: With --dry-run, take small scans of each kind of trials, once on a machine, and
            state the time of the study.
        shard: Run one of N parts, such as 2/4, each in a DIR of its own, as a job array does.
        merge: Join the folders of all shards in DIR, instead of running trials.
    """
    if retry_failed and not resume:
        raise InputError("--retry-failed needs --resume")
    if jobs is not None and jobs < 1:
        raise InputError(f"--jobs {jobs}: must be at least 1")
    if merge and (shard or dry_run or address or jobs or retry_failed):
        raise InputError("--merge runs no trials: only --out goes with it")
    if time and not dry_run:
        raise InputError("--time needs --dry-run")
    if dry_run:
        with on_terminal() as audience:
            planned = preview(
                file, out, jobs=jobs, retry=retry_failed, time=time, observers=audience
            )
        _show(planned)
        return
    with on_terminal() as audience, _Line() as line:
        if merge:
            finished = merge_study(file, out, merge, observers=audience)
        else:
            finished = run_study(
                file,
                out,
                address=address,
                jobs=jobs,
                resume=resume,
                retry=retry_failed,
                shard=shard,
                tell=line.tell,
                observers=audience,
            )
    failed = f", {finished.failed} failed" if finished.failed else ""
    Console().print(
        f"{counted(finished.done, 'trial')} done{failed}; the page is {finished.folder.page}",
        highlight=False,
        soft_wrap=True,
    )
    if finished.failed:
        sys.stderr.write(
            f"twinct: {counted(finished.failed, 'trial')} failed, the first because: "
            f"{shortened(finished.problem)}{if_little()}; change the study and continue it with "
            "--resume, or let --resume --retry-failed try them again\n"
        )


def _show(preview: DryRun) -> None:
    console, estimate = Console(), preview.estimate
    table = Table(box=None)
    labels = list(preview.trials[0].axes) if preview.trials else []
    for name in ("trial", *labels, "seed"):
        table.add_column(name)
    for trial in preview.trials[:_MOST_SHOWN]:
        values = [_in_words(trial.axes[name]) for name in labels]
        table.add_row(str(trial.number), *values, "" if trial.seed is None else str(trial.seed))
    console.print(table)
    if len(preview.trials) > _MOST_SHOWN:
        console.print(f"... and {len(preview.trials) - _MOST_SHOWN} more trials, left out here")
    there = f", {preview.there} already present" if preview.there else ""
    size = f"{estimate.disk_bytes / 1e6:.1f} MB" if estimate.disk_bytes < 1e9 else ""
    size = size or f"{estimate.disk_bytes / 1e9:.2f} GB"
    first = (
        f" (the first batch of {preview.total})"
        if preview.total > estimate.trials + preview.there
        else ""
    )
    trials, scans = _number(estimate.trials, "trial"), _number(estimate.scans, "scan")
    console.print(f"{trials} to run{first}{there}; {scans}", highlight=False)
    known = (
        "" if estimate.measured else " at most: no trial of this kind has run on this machine yet"
    )
    console.print(f"disk: {size}{known}", highlight=False)
    time = "unknown; --time measures it, by small scans"
    if estimate.seconds is not None:
        time = f"about {duration(estimate.seconds)}"
    console.print(f"time: {time}", highlight=False)


def _number(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _in_words(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


class _Line:
    """One line with the progress of a study; without a terminal, a new line every half minute."""

    def __init__(self) -> None:
        self._console = Console(stderr=True)
        self._live = Live(console=self._console, transient=True, refresh_per_second=4)
        self._shown = time.monotonic()

    def __enter__(self) -> _Line:
        return self

    def __exit__(self, *exception: object) -> None:
        self._live.stop()

    def tell(self, tally: Tally) -> None:
        """Show the tally."""
        text = f"{tally.done} done, {tally.running} running, {tally.failed} failed"
        text += f" of {tally.total}"
        if tally.left_s is not None and tally.left_s > 0:
            text += f", about {duration(tally.left_s)} left"
        if self._console.is_terminal:
            self._live.start()
            self._live.update(Text(text))
        elif time.monotonic() - self._shown > _LINE_EVERY_S:
            self._shown = time.monotonic()
            self._console.print(text, highlight=False)
