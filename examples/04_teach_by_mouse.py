"""
Teach it by hand: lead the arm, learn, and let it wipe on
=========================================================

The parts of ``fmp-drake teach``. A hand leads the arm, whose weight is compensated; what it shows
is recorded and learned, and the arm plays it from where it is. Here a simulated hand leads, so that
nobody has to; with ``--page`` it is you: hold Ctrl and drag the eraser with the left mouse button,
the same movement again and again. After 20 s it learns by itself. ::

    python examples/04_teach_by_mouse.py          # fast, led by a simulated hand
    python examples/04_teach_by_mouse.py --page   # led by your mouse
"""

import sys
import time

import matplotlib.pyplot as plt
from pydrake.geometry import Meshcat, MeshcatParams

from fmp_drake.runs import TeachingSession
from fmp_drake.station import LoadScenario, MouseOnPage, SimulatedHand
from fmp_drake.systems import HandMotion, PagePanel

page = "--page" in sys.argv
scenario = LoadScenario("table_top")

if page:
    panel = PagePanel(Meshcat(MeshcatParams(host="localhost")))
    hand = MouseOnPage(panel.meshcat)
    session = TeachingSession(scenario, hand, panel=panel, clock=time.monotonic)
    print(f"lead it at {panel.url}")
else:
    hand = SimulatedHand(HandMotion.make("eight", seconds=20.0, seed=0))
    session = TeachingSession(scenario, hand, clock=None)

# %%
# Show
# ----

while sum(shown.duration for shown in session.demonstrations) < (
    20.0 if page else 12.5
):
    session.advance(0.5)
demonstrations = session.demonstrations

# %%
# Learn, and wipe on
# ------------------
# The session has the buttons of the page: learn, again, play, teach, more and save.

session.press("learn")
print(session.remark)
session.advance(30.0 if page else 4.0)
print(session.status)

# %%
figure, ax = plt.subplots(figsize=(6, 5), layout="constrained")
for shown in demonstrations:
    ax.plot(1e3 * shown.values[:, 0], 1e3 * shown.values[:, 1], color="tab:orange")
ax.set(xlabel="x on the board (mm)", ylabel="y (mm)", title="what was shown")
ax.set_aspect("equal")
plt.show()
