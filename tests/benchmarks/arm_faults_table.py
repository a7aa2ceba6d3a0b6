"""Write a table of an arm's reactions to many faults of its messages.

``python tests/benchmarks/arm_faults_table.py out/arm_faults.md``
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from arm_faults import NOW, FailingNetwork, Fault, Neighbour, frozen

from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.station import models_dir
from fmp_drake.station.robots import panda_lcm
from fmp_drake.station.robots.panda_lcm import TorquePublisher


def late(ms):
    return lambda _ms, _message, earlier: (
        [earlier[-ms - 1]] if len(earlier) > ms else []
    )


def lost(fraction, seed=0):
    random = np.random.default_rng(seed)
    return lambda _ms, message, _earlier: (
        [message] if random.random() >= fraction else []
    )


def reordered(every):
    def change(ms, message, earlier):
        return [message, earlier[-3]] if ms % every == every - 1 else [message]

    return change


def repeated(times):
    return lambda _ms, message, _earlier: [message] * times


def stuck():
    """Repeat the first message, stamp and all."""
    first = []

    def change(_ms, message, _earlier):
        first.append(message)
        return [first[0]]

    return change


def corrupt(fraction, bits=1, seed=0):
    random = np.random.default_rng(seed)

    def change(_ms, message, _earlier):
        data = bytearray(message.encode())
        if random.random() < fraction:
            for _ in range(bits):
                data[random.integers(len(data))] ^= 1 << random.integers(8)
        return [bytes(data)]

    return change


def raw(data):
    return lambda _ms, message, _earlier: [data(message.encode())]


def field(name, value):
    def change(_ms, message, _earlier):
        setattr(message, name, value)
        return [message]

    return change


def stamp(offset):
    def change(_ms, message, _earlier):
        message.utime += offset
        return [message]

    return change


def row(name, joint, change_of, *, only=None):
    def change(ms, message, _earlier):
        if only is None or ms in only:
            values = list(getattr(message, name))
            values[joint] = change_of(ms, values[joint])
            setattr(message, name, values)
        return [message]

    return change


def half_frozen(name):
    first = []

    def change(_ms, message, _earlier):
        first.append(getattr(message, name))
        setattr(message, name, first[0])
        return [message]

    return change


def scaled(name, factor):
    def change(_ms, message, _earlier):
        setattr(message, name, [factor * x for x in getattr(message, name)])
        return [message]

    return change


q, v, torque = "joint_position", "joint_velocity", "joint_torque"
FAULTS = {
    "frozen state": Fault(status=frozen()),
    "frozen state for 20 ms": Fault(status=frozen(), duration=20),
    "frozen state for 600 ms": Fault(status=frozen(), duration=600),
    "frozen positions": Fault(status=half_frozen(q)),
    "frozen velocities": Fault(status=half_frozen(v)),
    "frozen robot_utime": Fault(status=field("robot_utime", 5)),
    "same message again and again": Fault(status=stuck()),
    **{f"statuses {ms} ms late": Fault(status=late(ms)) for ms in (5, 20, 49, 60, 150)},
    **{f"statuses {ms} ms late for 100 ms": Fault(status=late(ms), duration=100)
       for ms in (20, 60)},
    **{f"{p:.0%} of statuses lost": Fault(status=lost(p)) for p in (0.05, 0.5, 0.9)},
    "no statuses": Fault(status=lost(1.0)),
    "no statuses for 40 ms": Fault(status=lost(1.0), duration=40),
    "no statuses for 100 ms": Fault(status=lost(1.0), duration=100),
    "reordered, every 2nd": Fault(status=reordered(2)),
    "reordered, every 50th": Fault(status=reordered(50)),
    "each status twice": Fault(status=repeated(2)),
    "each status 20 times": Fault(status=repeated(20)),
    **{f"{n} wrong bits in {p:.0%}": Fault(status=corrupt(p, n))
       for n, p in ((1, 0.01), (1, 0.2), (1, 1.0), (20, 1.0))},
    "half of each message": Fault(status=raw(lambda data: data[: len(data) // 2])),
    "empty messages": Fault(status=raw(lambda _: b"")),
    "noise for messages": Fault(status=raw(lambda data: bytes(reversed(data)))),
    "six joints": Fault(status=field("num_joints", 6), duration=1),
    **{f"control_mode {n}": Fault(status=field("control_mode", n)) for n in (0, 1, 2, 5)},
    **{f"robot_mode {n}": Fault(status=field("robot_mode", n)) for n in (0, 1, 3, 4, 5)},
    "stamp 0": Fault(status=field("utime", 0)),
    "stamps 1 s in the past": Fault(status=stamp(-1_000_000)),
    "stamps 1 s in the future": Fault(status=stamp(1_000_000)),
    "stamps 40 ms in the future": Fault(status=stamp(40_000)),
    "NaN position": Fault(status=row(q, 3, lambda *_: np.nan)),
    "NaN velocity": Fault(status=row(v, 3, lambda *_: np.nan)),
    "NaN torque": Fault(status=row(torque, 3, lambda *_: np.nan)),
    "infinite position": Fault(status=row(q, 0, lambda *_: np.inf)),
    "900 rad": Fault(status=row(q, 3, lambda *_: 900.0)),
    "-500 rad/s": Fault(status=row(v, 3, lambda *_: -500.0)),
    "-500 rad/s once": Fault(status=row(v, 3, lambda *_: -500.0, only=(0,))),
    "3 rad/s": Fault(status=row(v, 1, lambda *_: 3.0)),
    "+0.5 rad": Fault(status=row(q, 3, lambda _, x: x + 0.5)),
    "+0.5 rad once": Fault(status=row(q, 3, lambda _, x: x + 0.5, only=(0,))),
    "+0.05 rad": Fault(status=row(q, 1, lambda _, x: x + 0.05)),
    "-0.02 rad": Fault(status=row(q, 1, lambda _, x: x - 0.02)),
    "+1 rad/s": Fault(status=row(v, 1, lambda _, x: x + 1.0)),
    "+0.3 rad/s": Fault(status=row(v, 1, lambda _, x: x + 0.3)),
    "position drifts by 1 rad/s": Fault(status=row(q, 3, lambda ms, x: x + 1e-3 * ms)),
    "position drifts by 0.1 rad/s": Fault(status=row(q, 3, lambda ms, x: x + 1e-4 * ms)),
    "velocities negative": Fault(status=scaled(v, -1.0)),
    "velocities doubled": Fault(status=scaled(v, 2.0)),
    "velocities zero": Fault(status=scaled(v, 0.0)),
    "positions negative": Fault(status=scaled(q, -1.0)),
    "positions in degrees": Fault(status=scaled(q, 180 / np.pi)),
    **{f"controller paused for {ms} ms": Fault(controller_pause=ms)
       for ms in (10, 40, 100)},
    "controller killed": Fault(controller_pause=10**9),
    "arm paused for 100 ms": Fault(arm_pause=100),
    "commands lost": Fault(command=lost(1.0)),
    "half of the commands lost": Fault(command=lost(0.5)),
    "commands 20 ms late": Fault(command=late(20)),
    "commands 60 ms late": Fault(command=late(60)),
    "each command twice": Fault(command=repeated(2)),
    "operator stops": "stop",
    "another controller sends zeros": "zeros",
    "another controller sends 5 Nm": "five",
    "another controller just before ours": lambda _torque: np.zeros(7),
    "another controller repeats ours, before": lambda torque: torque,
}  # fmt: skip


def react(network, fault):
    if isinstance(fault, Fault):
        return network.react(fault)
    if fault == "stop":
        network.run.stop()
        return network.react(Fault())
    if callable(fault):
        Neighbour.before = staticmethod(fault)
        try:
            return network.react(Fault())
        finally:
            Neighbour.before = None
    publish = TorquePublisher(network.bus, "PANDA_COMMAND")
    forward = TorquePublisher(network.arm_bus, "PANDA_COMMAND")
    value = np.full(7, 5.0 if fault == "five" else 0.0)

    def other(_ms, message, _earlier):
        publish(value, NOW + 1e-3 * network.ticks)
        forward(value, NOW + 1e-3 * network.ticks)
        return [message]

    # For 100 ms: it, too, is one that stops.
    return network.react(Fault(status=other, duration=100))


class Noticed:
    """A change of messages, and the millisecond at which it first changed one."""

    def __init__(self, change):
        self.first, self._change = None, change

    def __call__(self, ms, message, earlier):
        before = message.encode()
        messages = self._change(ms, message, earlier)
        data = [m if isinstance(m, bytes) else m.encode() for m in messages]
        if data != [before] and self.first is None:
            self.first = ms
        return messages


class FewestDegrees:
    """Movement where the operator stops the arm when a fault first changes a message."""

    def __init__(self, skill):
        self._skill, self._known = skill, {}

    def __call__(self, first):
        if first not in self._known:
            network = FailingNetwork(self._skill).begin(500)
            start = network.states[-1][:7]
            network.advance(first)
            network.run.stop()
            network.advance(500 - first)
            moved = np.abs(np.array(network.states[-500:])[:, :7] - start)
            self._known[first] = float(np.degrees(np.max(moved)))
        return self._known[first]


def main(path):
    panda_lcm.TorquePublisher = Neighbour
    shown = Demonstration.load(models_dir() / "demonstrations" / "wiping.npz")
    skill = FourierMovementPrimitive(n_steps=20, overlap=5, n_components=4).fit(shown)
    lines = [
        "# What an arm does after a fault behind its messages",
        "",
        "A simulated Panda plays wiping. The fault comes 0.5 s after it was enabled, while",
        "it approaches the board. Within 500 ms after the fault: the largest movement of a",
        "joint, and the largest fractions of its limits of speed (also before) and torque.",
        "Where no time is given, the arm was not stopped, and its movement is that of the",
        "skill. *At best* is the movement if the operator stops the arm in the millisecond",
        "in which the fault changes the first message.",
        "",
        "| fault | stopped after, ms | as | degrees | at best | before | speed | torque |",
        "|---|---|---|---|---|---|---|---|",
    ]
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    fewest_degrees = FewestDegrees(skill)
    for name, fault in FAULTS.items():
        first = 0
        if isinstance(fault, Fault):
            changes = Noticed(fault.status), Noticed(fault.command)
            fault = replace(fault, status=changes[0], command=changes[1])
        network = FailingNetwork(skill).begin(500)
        reaction = react(network, fault)
        if isinstance(fault, Fault):
            first = min((c.first for c in changes if c.first is not None), default=0)
        after = "" if reaction.stopped_after is None else reaction.stopped_after
        lines.append(
            f"| {name} | {after} | {reaction.faults.name or ''} | "
            f"{np.degrees(reaction.moved):.2f} | {fewest_degrees(first):.2f} | "
            f"{reaction.speed_before:.3f} | {reaction.speed:.3f} | "
            f"{reaction.torque:.3f} |"
        )
        print(lines[-1], flush=True)  # noqa: T201
        Path(path).write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
