"""Recordings of a Panda's joints as paths of the eraser that it would hold."""

import re
from dataclasses import replace

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from fmp_drake.errors import DemonstrationError
from fmp_drake.primitives import Demonstration
from fmp_drake.station.models.model_files import AddPandaWithEraser
from fmp_drake.station.scenario_parts import EraserConfig

# Names without a robot's are taken for a Panda's where the angles are possible.
_JOINT = re.compile(
    r"(?:.*(?:panda|fr3|franka|fer)\d*_)?(?:joint|q|j)[_.]?(\d)([_.]pos(ition)?)?",
    re.IGNORECASE,
)
_MARGIN = 0.05  # rad


def PandaJoints(demonstration: Demonstration) -> list[str]:
    """Return the channels of a Panda's seven joints in order, or none.

    They are numbered from 1 or 0: `panda_joint1`, `fr3_joint1`, `q1`.
    """
    numbers = {
        int(found[1]): name
        for name in demonstration.channels
        if (found := _JOINT.fullmatch(name))
    }
    for first in (1, 0):
        if sorted(numbers) == list(range(first, first + 7)):
            return [numbers[i] for i in sorted(numbers)]
    return []


def EraserPath(
    demonstration: Demonstration, *, eraser: EraserConfig | None = None
) -> Demonstration:
    """Return where the eraser was while a Panda's joints were recorded.

    Parameters
    ----------
    demonstration : Demonstration
        With the channels of `PandaJoints`, rad.
    eraser : EraserConfig, optional
        The default one where None.

    Returns
    -------
    Demonstration
        x, y and z of the eraser's tip in the frame `panda_link0`, m.

    Raises
    ------
    DemonstrationError
        Where a joint is not a Panda's, for it leaves its limits.

    Examples
    --------
    >>> posture = [0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4]
    >>> joints = Demonstration(
    ...     time=np.arange(4) / 20,
    ...     values=np.tile(posture, (4, 1)),
    ...     channels=tuple(f"panda_joint{i}" for i in range(1, 8)),
    ...     units=("rad",) * 7,
    ... )
    >>> EraserPath(joints).values[0].round(2) + 0.0
    array([0.31, 0.  , 0.49])
    """
    joints = PandaJoints(demonstration)
    if not joints:
        raise DemonstrationError(
            f"the channels {', '.join(demonstration.channels)} are no Panda's joints; "
            "expected panda_joint1 to panda_joint7."
        )
    angles = demonstration.select(joints).values
    plant = MultibodyPlant(0.0)
    _, tool = AddPandaWithEraser(plant, eraser=eraser)
    plant.Finalize()
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    outside = (angles < lower - _MARGIN) | (angles > upper + _MARGIN)
    if np.any(outside):
        sample, i = np.argwhere(outside)[0]
        raise DemonstrationError(
            f"{joints[i]} is {angles[sample, i]:.3g} in sample {sample}; a Panda's joint "
            f"{i + 1} is from {lower[i]:.3g} to {upper[i]:.3g} rad. Of another robot, "
            "record the position of its tool; of this one, give radians."
        )
    context = plant.CreateDefaultContext()
    tip = plant.GetFrameByName("eraser_tip", tool)
    path = np.empty((len(angles), 3))
    for i, q in enumerate(angles):
        plant.SetPositions(context, q)
        path[i] = tip.CalcPoseInWorld(context).translation()
    return replace(
        demonstration,
        values=path,
        channels=("x", "y", "z"),
        units=("m", "m", "m"),
        frame="panda_link0",
        rotation_reference=None,
    )
