"""``python scan_parent.py SCENARIO LOG_DIR VIEWS``: a scan around tiny engines, to be disturbed."""

import os
import sys
import time
from pathlib import Path

from twinct.errors import TwinctError
from twinct.ros import RosRig
from twinct.scan import Workshop
from twinct.scenario import load_scenario

scenario = load_scenario(sys.argv[1])
targets = Workshop(scenario).targets
command = sys.executable, str(Path(__file__).with_name("fake_node.py"))
try:
    with RosRig(scenario, node_command=command, log_dir=Path(sys.argv[2])) as rig:
        pids = [node.pid for node in rig._nodes]
        print(rig.domain_id, os.getpid(), *pids, flush=True)  # noqa: T201
        for view in range(int(sys.argv[3])):
            rig.move(view, targets[view])
            rig.expose(view)
            time.sleep(0.02)
            print(view, flush=True)  # noqa: T201
except TwinctError as error:
    sys.stderr.write(f"{type(error).__name__}: {error}\n")
    sys.exit(error.exit_code)
