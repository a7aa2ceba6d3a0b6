"""Facts about a simulated hand that turns the tool, and one that presses it."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from fmp_drake.errors import StationError
from fmp_drake.station import LoadScenario, MakeStation
from fmp_drake.station.external_forces import DemonstrationFromRecorder, SimulatedHand
from fmp_drake.systems.teaching.hand_motion import HandMotion

pytestmark = pytest.mark.slow


def recorded(task, scenario, *, seconds, skip):
    """Return a motion and what the station records of it."""
    motion = HandMotion.make(task, duration=seconds + 1, seed=3)
    station = MakeStation(LoadScenario(scenario), SimulatedHand(motion))
    simulator = Simulator(station)
    simulator.AdvanceTo(seconds)
    context = simulator.get_context()
    shown = DemonstrationFromRecorder(station, context, skip=skip, note="")
    wanted = np.array([motion.at(t + skip)[0] for t in shown.time])
    return dict(zip(motion.channels, wanted.T, strict=True)), shown


def test_stirring_records_the_positions_and_orientations_of_the_hand():
    wanted, shown = recorded("stirring", "stir", seconds=5.0, skip=2.0)
    assert shown.channels == ("x", "y", "z", "rx", "ry", "rz")
    assert shown.units == ("m", "m", "m", "rad", "rad", "rad")
    assert shown.rotation_reference is not None
    for i, name in enumerate("xyz"):
        np.testing.assert_allclose(shown.values[:, i], wanted[name], atol=0.012)
    # It leans to the same side, and as far but for the inertia of the arm on the hand's
    # spring; the recording's own reference is its mean.
    for i, name in ((3, "rx"), (4, "ry")):
        assert np.corrcoef(shown.values[:, i], wanted[name])[0, 1] > 0.98
        assert np.ptp(shown.values[:, i]) == pytest.approx(
            np.ptp(wanted[name]), rel=0.2
        )


def test_pulsing_records_the_force_of_the_contact():
    wanted, shown = recorded("pulsing", "table_top", seconds=5.0, skip=2.0)
    assert shown.channels == ("x", "y", "z", "force")
    assert shown.units[3] == "N"
    # The inertia of the arm that is led sideways presses, too.
    force = shown.values[:, 3]
    assert np.corrcoef(force, wanted["force"])[0, 1] > 0.8
    assert np.mean(force) == pytest.approx(np.mean(wanted["force"]), abs=1.0)
    assert np.all(np.abs(shown.values[:, 2]) < 0.01)


def test_a_hand_that_guides_over_a_board_needs_one():
    motion = HandMotion.make("eight", duration=5.0, seed=0)
    with pytest.raises(StationError, match="use a motion with a height"):
        MakeStation(LoadScenario("stir"), SimulatedHand(motion))


def test_a_spoon_does_not_wipe_a_board():
    scenario = LoadScenario("stir")
    scenario.board.shape = "plane"
    with pytest.raises(StationError, match=r"Set board\.shape to none"):
        scenario.check()


def test_other_tools_are_model_files_with_two_frames(tmp_path):
    scenario = LoadScenario("stir")
    scenario.tool = "ladle"
    with pytest.raises(StationError, match="there is no tool ladle; choose eraser or"):
        MakeStation(scenario, None)
    stick = """<sdf version="1.9"><model name="stick"><link name="stick">
<inertial><mass>0.1</mass></inertial></link>
<frame name="mount" attached_to="stick"/>{}</model></sdf>"""
    tip = '<frame name="tip" attached_to="stick"><pose>0 0 0.2 0 0 0</pose></frame>'
    file = tmp_path / "stick.sdf"
    scenario.tool = str(file)
    file.write_text(stick.format(""), encoding="utf-8")
    with pytest.raises(
        StationError, match=r"mount and tip: it has no frame tip, but .*mount, stick\."
    ):
        MakeStation(scenario, None)
    brush = """<link name="brush"/><joint name="spin" type="revolute">
<parent>stick</parent><child>brush</child><axis><xyz>0 0 1</xyz></axis></joint>"""
    file.write_text(stick.format(tip + brush), encoding="utf-8")
    with pytest.raises(StationError, match="its spin can move; make it fixed"):
        MakeStation(scenario, None)
    file.write_text(stick.format(tip), encoding="utf-8")
    station = MakeStation(scenario, None)
    assert station.HasOutputPort("measured_pose")
