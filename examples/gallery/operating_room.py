"""
An operating room
=================

``operating_room`` has a patient on a table, a lamp, an anaesthesia machine, a
trolley and places for staff. The arms keep clear of all of them, and the beam sees the table.
"""

from twinct import load_scenario
from twinct.scan import SimulationBuilder

scenario = load_scenario("operating_room", {"trajectory.views": 60})
SimulationBuilder(scenario).draw("operating_room.png", view=22, width=1400, height=875)

# %%
# ``cell.room: operating`` puts this room around any scenario; ``cell.objects`` and ``cell.zones``
# add bodies of your own.
