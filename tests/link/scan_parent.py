"""``python scan_parent.py SCENARIO LOG_DIR``: a scan around tiny engines, to be disturbed."""

import os
import sys
from pathlib import Path

from twinct.core.errors import TwinctError
from twinct.geometry.wire import targets_of
from twinct.link import RosRig, heartbeat
from twinct.scenario import load_scenario
from twinct.trajectory import commanded_views

heartbeat.SILENCE_S = float(os.environ.get("FAKE_SILENCE_S", heartbeat.SILENCE_S))
scenario = load_scenario(sys.argv[1])
geometry = commanded_views(scenario.trajectory, scenario.detector.panel)
targets = targets_of(geometry)
command = sys.executable, str(Path(__file__).with_name("fake_node.py"))
try:
    with RosRig(scenario, node_command=command, log_dir=Path(sys.argv[2])) as rig:
        pids = [node.pid for node in rig._nodes]
        print(rig.domain_id, os.getpid(), *pids, flush=True)  # noqa: T201
        for view, target in enumerate(targets):
            rig.move(view, target)
            print(view, flush=True)  # noqa: T201
            rig.expose(view)
except TwinctError as error:
    sys.stderr.write(f"{type(error).__name__}: {error}\n")
    sys.exit(error.exit_code)
