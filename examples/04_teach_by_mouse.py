"""
Teach by hand guiding: show, learn, and let the arm continue
============================================================

The parts of ``fmp-drake teach``. A hand guides the arm, whose weight is compensated. Its motion is
recorded and learned, and the arm plays the skill from its current pose. Without options a simulated
hand guides the arm. With ``--page`` you do: drag the eraser with the mouse or a finger, the same
movement again and again. After 20 s the script learns by itself. ::

    python examples/04_teach_by_mouse.py          # fast, guided by a simulated hand
    python examples/04_teach_by_mouse.py --page   # guided by your mouse
"""

# sphinx_gallery_thumbnail_path = '../page.png'

import sys
import time

import matplotlib.pyplot as plt

from fmp_drake.runs import TeachingSession
from fmp_drake.station import LoadScenario, MouseOnPage, SimulatedHand
from fmp_drake.systems import HandMotion, PagePanel, hidden_meshcat

page = "--page" in sys.argv
scenario = LoadScenario("table_top")

if page:
    panel = PagePanel(hidden_meshcat())
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
# The session has the buttons of the page: learn, again, undo, play, teach, more and save.

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
