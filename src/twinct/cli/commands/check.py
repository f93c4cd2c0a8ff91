"""``twinct check``: whether a scenario can be run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Column, Table

from twinct.cli.arguments import Flag, Json, Overrides, ScenarioFile, Threads
from twinct.cli.json_answer import answering
from twinct.cli.progress import on_terminal, warnings_to
from twinct.cli.scenario_at import scenario_at
from twinct.cli.time_limit import limited
from twinct.core.threads import limit_threads
from twinct.runs import checking


def check(
    scenario: ScenarioFile,
    *,
    save: Annotated[Path | None, tyro.conf.arg(metavar="NPZ")] = None,
    picture: Annotated[Path, tyro.conf.arg(metavar="PNG")] = Path("view.png"),
    no_cures: Flag = False,
    all_cures: Flag = False,
    time: Flag = False,
    time_limit: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None,
    threads: Threads = None,
    as_json: Json = False,
    set_: Overrides = (),
) -> None:
    """Validate a scenario, build its specimen, plan its motion and rehearse it, without running it.

    The rehearsal simulates the arms' motion without images, and finds every view that a run would
    miss. The command lists every view that an arm cannot reach or that would collide, suggests a
    remedy, and draws the first of these views.

    Args:
        save: File for the plan; a scenario follows it with the key motion.plan.
        picture: File for the picture of an infeasible view.
        no_cures: Report infeasible views without a remedy and a picture.
        all_cures: Try all changes that may help, even if that takes longer than planning.
        time: Take small scans of the scenario, once for each kind on a machine, and state the
            time of a run.
        time_limit: Longest time that the check may take; then it ends with the problems found.
    """
    limit_threads(threads)
    with answering(as_json) as answer, limited(time_limit, "--time-limit"):
        answer |= {"scenario": str(scenario), "can_be_run": False, "warnings": []}
        with (
            scenario_at(scenario, set_) as loaded,
            on_terminal([warnings_to(answer["warnings"])]) as audience,
        ):
            checked = checking.check(
                loaded,
                save=save,
                cures=not no_cures,
                all_cures=all_cures,
                picture=picture,
                time=time,
                observers=audience,
            )
        answer |= {"can_be_run": True, "findings": checked.findings}
        doubt = ", with the warnings above" if answer["warnings"] else ""
        # Long words, such as a digest, go on in the next line.
        title = f"{loaded.name}: can be run{doubt}"
        table = Table("", Column(overflow="fold"), title=title, show_header=False)
        for name, words in checked.findings.items():
            table.add_row(name, words)
        Console().print(table)
