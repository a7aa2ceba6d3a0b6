"""
Teach by hand guiding: demonstrate, learn, and let the arm continue
===================================================================

The parts of ``fmp-drake teach``. A hand guides the arm, whose weight is compensated. Its motion is
recorded and learned, and the arm plays the skill from its current pose. By default a simulated hand
guides the arm. With ``--page`` you do: drag the eraser with the mouse or a finger, and repeat the
movement. After 20 s the script learns the skill. ::

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
    print(f"guide the arm at {panel.url}")
else:
    hand = SimulatedHand(HandMotion.make("eight", duration=20.0, seed=0))
    session = TeachingSession(scenario, hand, clock=None)

# %%
# Demonstrate
# -----------

duration = 20.0 if page else 12.5
while sum(recording.duration for recording in session.demonstrations) < duration:
    session.advance(0.5)
demonstrations = session.demonstrations

# %%
# Learn, and continue wiping
# --------------------------
# The session has the buttons of the page: learn, again, undo, play, teach, more and save.

session.press("learn")
print(session.remark)
session.advance(30.0 if page else 4.0)
print(session.status)

# %%
figure, ax = plt.subplots(figsize=(6, 5), layout="constrained")
for recording in demonstrations:
    x, y, _ = 1e3 * recording.values.T
    ax.plot(x, y, color="tab:orange")
ax.set(xlabel="x on the board (mm)", ylabel="y (mm)", title="demonstration")
ax.set_aspect("equal")
plt.show()
