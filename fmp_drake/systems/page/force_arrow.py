"""The contact force in Meshcat, as an arrow."""

from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import Cylinder, Meshcat, MeshcatCone, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import Context, LeafSystem

from fmp_drake.numeric import Array
from fmp_drake.systems.interface.callbacks import collision_ids, contact_surfaces

FORCE_COLOR = Rgba(0.85, 0.10, 0.10, 1.0)
"""Colour of the arrow."""

_PATH = "/force"
# Length of the arrow in m per N, and time between two pictures in s.
_SCALE, _PERIOD = 0.012, 0.032
_RADIUS = 0.004
_HEAD = 0.022
_HEAD_RADIUS = 0.010
# Weakest force that is drawn, N: the direction of weaker ones is noise.
_WEAKEST = 0.3


class ForceArrow(LeafSystem):
    """Arrow of the contact force on a body.

    The arrow begins in the middle of the contact, weighted by the forces. It is drawn
    over objects in front of it, so that the body itself does not hide it. It is moved
    and stretched, not drawn again, so that recordings show it too. It is at `/force` in
    Meshcat's tree: outside of `/drake` the mouse ignores it.

    Input ports
    -----------
    contact_results : abstract
        The plant's; hydroelastic contacts count.

    Parameters
    ----------
    plant : MultibodyPlant
        Finalized.
    body : RigidBody
        Whose contacts count.
    meshcat : Meshcat

    Examples
    --------
    >>> from pydrake.geometry import Meshcat
    >>> from pydrake.systems.framework import DiagramBuilder
    >>> from fmp_drake.station import AddBoardScene, Scenario
    >>> builder = DiagramBuilder()
    >>> scene = AddBoardScene(builder, Scenario(), start=[0.0, 0.0, 0.05])
    >>> plant, meshcat = scene.plant, Meshcat()
    >>> arrow = ForceArrow(plant, body=scene.robot.tip.body(), meshcat=meshcat)
    >>> arrow = builder.AddSystem(arrow)
    >>> port = plant.GetOutputPort("contact_results")
    >>> _ = builder.Connect(port, arrow.GetInputPort("contact_results"))
    """

    def __init__(
        self, plant: MultibodyPlant, *, body: RigidBody, meshcat: Meshcat
    ) -> None:
        super().__init__()
        self.set_name("force_arrow")
        self._ids = collision_ids(plant, body)
        self._meshcat = meshcat
        self._results = self.DeclareAbstractInputPort(
            "contact_results", AbstractValue.Make(ContactResults())
        )
        self.DeclareInitializationPublishEvent(self._begin)
        self.DeclarePeriodicPublishEvent(_PERIOD, 0.0, self._draw)

    def _begin(self, context: Context) -> None:
        meshcat, path = self._meshcat, _PATH
        meshcat.Delete(path)
        meshcat.SetObject(f"{path}/stretch/shaft", Cylinder(_RADIUS, 1.0), FORCE_COLOR)
        head = MeshcatCone(_HEAD, _HEAD_RADIUS, _HEAD_RADIUS)
        meshcat.SetObject(f"{path}/head/cone", head, FORCE_COLOR)
        # From the origin to 1 m; Meshcat's cone points downwards.
        meshcat.SetTransform(f"{path}/stretch/shaft", _along_z(0.5))
        upside_down = RigidTransform(RotationMatrix.MakeXRotation(np.pi))
        meshcat.SetTransform(f"{path}/head/cone", _along_z(_HEAD) @ upside_down)
        for part in ("stretch/shaft", "head/cone"):
            for name in ("material.depthTest", "castShadow", "receiveShadow"):
                meshcat.SetProperty(f"{path}/{part}/<object>", name, False)
            meshcat.SetProperty(f"{path}/{part}/<object>", "renderOrder", 10.0)
        self._draw(context)

    def _force(self, context: Context) -> tuple[Array, Array]:
        """Return the point of application (W, m) and the force (W, N)."""
        results: Any = self._results.Eval(context)
        force, point, weight = np.zeros(3), np.zeros(3), 0.0
        for surface, part, _ in contact_surfaces(results, self._ids):
            size = float(np.linalg.norm(part))
            force += part
            point += size * surface.centroid()
            weight += size
        return point / max(weight, 1e-12), force

    def _draw(self, context: Context) -> None:
        point, force = self._force(context)
        time, strength = context.get_time(), float(np.linalg.norm(force))
        visible = strength > _WEAKEST
        self._meshcat.SetProperty(_PATH, "visible", visible, time_in_recording=time)
        if not visible:
            return
        rotation = RotationMatrix.MakeFromOneVector(force, 2)
        self._meshcat.SetTransform(_PATH, RigidTransform(rotation, point), time)
        shaft = max(_SCALE * strength - _HEAD, 1e-3)
        self._meshcat.SetTransform(f"{_PATH}/head", _along_z(shaft), time)
        self._meshcat.SetProperty(f"{_PATH}/stretch", "scale", [1.0, 1.0, shaft], time)


def _along_z(height: float) -> RigidTransform:
    return RigidTransform(np.array([0.0, 0.0, height]))
