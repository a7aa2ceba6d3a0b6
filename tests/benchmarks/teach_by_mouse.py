"""Teach by a synthetic mouse, learn, play, and write a table of the results.

    python teach_by_mouse.py --duration 30 --play 60 --frames 60
    python teach_by_mouse.py --shape eight --board vertical --frames 10 --play 0

Shapes on boards, each seen by the scenario's camera and by one from the other side. Columns:
rms of the recording from the cursor's path, after its lag; the largest used fractions of the joints' ranges, speeds
and torques while it was taught; and when it played, the share of the shown area that is
clean, the largest distance of the eraser from what was shown (in the plane of the board), the
part of the time within 20 mm of it, the fractions of speeds and torques, the CPU time from
learn to playing, and what went wrong (nothing, in all of them). The table, of the scenario's own
camera; from the other side all figures are within 0.2 of these:

    table_top  eight   own     60    1.1  0.57  0.31  0.47   96.7   4.6 100.0  0.28  0.40
    table_top  circle  own     60    0.7  0.65  0.26  0.48   93.7   3.6 100.0  0.25  0.41
    table_top  zigzag  own     60    1.8  0.56  0.32  0.48   92.1   4.0 100.0  0.24  0.40
    table_top  square  own     60    0.9  0.63  0.26  0.48   92.9   3.8 100.0  0.20  0.40
    tilted     eight   own     60    1.4  0.53  0.32  0.38   97.5   4.8 100.0  0.27  0.24
    tilted     circle  own     60    0.9  0.60  0.26  0.32   93.6   3.8 100.0  0.24  0.24
    tilted     zigzag  own     60    2.1  0.52  0.34  0.51   91.9   4.1 100.0  0.23  0.24
    tilted     square  own     60    1.1  0.58  0.27  0.35   92.9   3.9 100.0  0.20  0.24
    vertical   eight   own     60    1.0  0.58  0.31  0.24   96.7   4.9 100.0  0.26  0.21
    vertical   circle  own     60    0.7  0.61  0.27  0.20   93.6   3.7 100.0  0.23  0.21
    vertical   zigzag  own     60    1.8  0.58  0.33  0.34   92.4   3.8 100.0  0.22  0.21
    vertical   square  own     60    0.9  0.60  0.27  0.22   92.7   3.7 100.0  0.19  0.21
    table_top  eight   own     10    1.1  0.57  0.31  0.47
    table_top  circle  own     10    0.8  0.65  0.26  0.48
    table_top  zigzag  own     10    1.8  0.55  0.32  0.48
    table_top  square  own     10    1.0  0.63  0.26  0.48
    tilted     eight   own     10    1.3  0.53  0.32  0.37
    tilted     circle  own     10    0.9  0.60  0.26  0.32
    tilted     zigzag  own     10    2.0  0.52  0.34  0.50
    tilted     square  own     10    1.1  0.58  0.27  0.35
    vertical   eight   own     10    1.0  0.58  0.31  0.23
    vertical   circle  own     10    0.7  0.61  0.27  0.20
    vertical   zigzag  own     10    1.8  0.58  0.32  0.34
    vertical   square  own     10    1.0  0.60  0.27  0.21
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).parents[1]))
from page_mouse import SHAPES, TaughtSession

from fmp_drake.station import LoadScenario
from fmp_drake.systems.ink.grid import cleaned_fraction


def other_side(scenario):
    """Return an eye opposite to the scenario's, mirrored at the board's middle plane."""
    x, y, z = scenario.camera.eye
    return [x, -y, z]


def teach(board, shape, *, mirrored, frames, seconds, play):
    scenario = LoadScenario(board)
    eye = other_side(scenario) if mirrored else scenario.camera.eye
    taught = TaughtSession(
        scenario, frames=frames, latency=max(0.05, 1 / frames), eye=eye
    )
    taught.session.advance(1.5)
    taught.press()
    taught.drag(shape, seconds)
    taught.release()
    rms = taught.recording_error()
    worst = " ".join(f"{taught.worst[k]:5.2f}" for k in ("range", "speed", "torque"))
    line = f"{board:10} {shape:7} {'other' if mirrored else 'own':6} {frames:3.0f}"
    line += f" {1e3 * rms:6.1f} {worst}"
    if play:
        session = taught.session
        started = time.process_time()
        session.press("learn")
        if session.mode != "play":
            return f"{line}  {session.remark}"
        learned = time.process_time() - started
        run = session._run
        session.advance(play)
        metrics = run.metrics()
        clean = cleaned_fraction(run.ink(), run.demonstrated_area)
        shown = np.concatenate([d.values[:, :2] for d in session._earlier])
        path = np.array([s[2:4] for s in session._samples])
        away, _ = cKDTree(shown).query(path)
        line += (
            f"  {100 * clean:5.1f} {1e3 * away.max():5.1f} {100 * np.mean(away < 0.02):5.1f}"
            f" {metrics['joint_speed_ratio_max']:5.2f} {metrics['torque_ratio_max']:5.2f}"
            f" {learned:5.2f}  {'; '.join(e.text for e in run.events())}"
        )
    return line


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shape", nargs="+", default=list(SHAPES))
    parser.add_argument(
        "--board", nargs="+", default=["table_top", "tilted", "vertical"]
    )
    parser.add_argument("--camera", nargs="+", default=["own", "other"])
    parser.add_argument("--frames", type=float, default=60.0)
    parser.add_argument("--duration", type=float, default=30.0)
    parser.add_argument("--play", type=float, default=60.0)
    chosen = parser.parse_args()
    sys.stdout.write(
        "board      shape   camera f/s rms/mm  range speed torque"
        "  clean  away  in20 speed torque learn/s\n"
    )
    for camera in chosen.camera:
        for board in chosen.board:
            for shape in chosen.shape:
                line = teach(
                    board,
                    shape,
                    mirrored=camera == "other",
                    frames=chosen.frames,
                    seconds=chosen.duration,
                    play=chosen.play,
                )
                sys.stdout.write(f"{line}\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main()
