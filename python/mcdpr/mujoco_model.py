"""The robot in MuJoCo: its exported model, driven by what this package knows of it."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import numpy as np

from ._arrays import Array, Numbers, vector
from .errors import InputError, RunError

if TYPE_CHECKING:
    from .robot import Equilibrium, Robot


def quaternion_from_rpy(attitude_rad: Numbers) -> Array:
    """(4,): w, x, y, z of R = Rz Ry Rx."""
    angles = vector("attitude_rad", attitude_rad, 3, "roll, pitch, yaw")
    (cr, cp, cy), (sr, sp, sy) = np.cos(np.array(angles) / 2), np.sin(np.array(angles) / 2)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


class MujocoModel:
    """MuJoCo's model and data of a robot, with what its cables mean.

    Needs the package ``mujoco``. Cable i of the robot is entry i - 1.
    """

    model: Any
    data: Any

    def __init__(self, robot: Robot, *, every_winch: bool = False) -> None:
        # It has no type stubs, and the package does not depend on it.
        mujoco: Any = importlib.import_module("mujoco")
        self.robot = robot
        self._mj = mujoco
        self.model = mujoco.MjModel.from_xml_string(
            robot.to_mjcf(every_winch=every_winch)
        )
        self.data = mujoco.MjData(self.model)
        values = robot.values
        cables = values["cables"]
        self.held = np.array([every_winch or cable["control"] == "Position" for cable in cables])
        self._ea_n = np.array([cable["ea_n"] for cable in cables])
        self._routing_m = np.array([cable["routing_length_m"] for cable in cables])
        home = robot.statics(values["tool"]["home_in_world_m"], "setpoint", tool=True)
        self._home_m = home.paid_out_m
        self._mass_kg = values["platform"]["mass_kg"]
        self._inertia_kg_m2 = np.array(values["platform"]["inertia_kg_m2"]).reshape(3, 3)
        self._platform = self.model.joint("platform").qposadr[0]
        self._platform_dof = self.model.joint("platform").dofadr[0]
        self._swivels: list[tuple[int, int]] = []
        self._winches: list[tuple[int, int]] = []
        for cable in range(robot.cable_count):
            if values["cables"][cable]["pulley_radius_m"] > 0.0:
                joint = self.model.joint(f"swivel_{cable + 1}")
                self._swivels.append((cable, joint.qposadr[0]))
            if self.held[cable]:
                joint = self.model.joint(f"winch_{cable + 1}")
                self._winches.append((cable, joint.qposadr[0]))
        self._home_way = self._way(home)
        self._damping = self.model.dof_damping.copy()
        self.reset()

    def _way(self, hanging: Equilibrium) -> Array:
        """(n, 3): where the pulleys look, unit vectors across their swivel axes."""
        cables = self.robot.values["cables"]
        axis = np.array([cable["swivel_axis_in_world"] for cable in cables])
        anchor = np.array([cable["anchor_in_world_m"] for cable in cables])
        directions = self.robot.ik(hanging.position_m, hanging.attitude_rad)
        away = directions.tangent_points_m + directions.directions - anchor
        across = away - axis * np.sum(away * axis, axis=1, keepdims=True)
        return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True))

    def reset(self) -> None:
        """The robot at rest at home, springs and damping as exported."""
        self._mj.mj_resetDataKeyframe(self.model, self.data, 0)
        self.model.dof_damping[:] = self._damping

    def put(self, hanging: Equilibrium, off_m: Numbers = (0.0, 0.0, 0.0)) -> None:
        """Winches and tensions as for an equilibrium of the robot, the platform there, or off it.

        The springs get the stiffness of the lengths that are paid out: exact, unlike the file's.
        """
        if hanging.position_m.ndim != 1:
            raise InputError(f"hanging: shape {hanging.position_m.shape}: give one pose")
        self.reset()
        taken_up = self._home_m - hanging.paid_out_m
        stiffness = self._ea_n / (hanging.paid_out_m + self._routing_m)
        self.model.tendon_stiffness[self.held] = stiffness[self.held]
        self.data.ctrl[:] = np.where(self.held, taken_up, hanging.tensions_n)
        for cable, at in self._winches:
            self.data.qpos[at] = taken_up[cable]
        cables = self.robot.values["cables"]
        way = self._way(hanging)
        for cable, at in self._swivels:
            axis = np.array(cables[cable]["swivel_axis_in_world"])
            sine = np.cross(self._home_way[cable], way[cable]) @ axis
            self.data.qpos[at] = np.arctan2(sine, self._home_way[cable] @ way[cable])
        at = self._platform
        self.data.qpos[at : at + 3] = hanging.position_m + np.array(off_m)
        self.data.qpos[at + 3 : at + 7] = quaternion_from_rpy(hanging.attitude_rad)
        self._mj.mj_forward(self.model, self.data)

    def settle(self, slowest_hz: float, most_s: float = 20.0, speed: float = 1e-7) -> bool:
        """Lets the platform come to rest, its slowest mode damped out; whether it did.

        Damping moves no equilibrium. ``speed`` is what counts as rest, m/s and rad/s.
        """
        omega = 2.0 * np.pi * max(abs(slowest_hz), 0.1)
        dof = self._platform_dof
        self.model.dof_damping[dof : dof + 3] = 2.0 * self._mass_kg * omega
        turning = 2.0 * float(np.trace(self._inertia_kg_m2)) / 3.0 * omega
        self.model.dof_damping[dof + 3 : dof + 6] = turning
        steps = int(most_s / self.model.opt.timestep)
        still = 0
        for _ in range(0, steps, 250):
            self._mj.mj_step(self.model, self.data, 250)
            still = still + 1 if float(np.abs(self.data.qvel).max()) < speed else 0
            if still >= 2:
                return True
        return False

    @property
    def position_m(self) -> Array:
        """(3,): platform's origin, world, m."""
        return np.array(self.data.qpos[self._platform : self._platform + 3])

    def turned_rad(self, attitude_rad: Numbers) -> float:
        """Angle between the platform and an attitude (3,), rad."""
        at = self._platform
        off = np.zeros(3)
        self._mj.mju_subQuat(
            off, self.data.qpos[at + 3 : at + 7].copy(), quaternion_from_rpy(attitude_rad)
        )
        return float(np.linalg.norm(off))

    @property
    def tensions_n(self) -> Array:
        """(n,): tension of each cable, N."""
        stretch = self.data.ten_length - self.model.tendon_lengthspring[:, 1]
        pull = np.maximum(0.0, self.model.tendon_stiffness * stretch)
        return np.asarray(np.where(self.held, pull, self.data.ctrl))


class MujocoPlant:
    """MuJoCo as the physics of a simulated robot: ``session.fly(MujocoPlant(robot))``.

    Platform and cables are MuJoCo's, everything else is this project's.
    """

    def __init__(self, robot: Robot) -> None:
        self.judge = MujocoModel(robot, every_winch=True)
        self._lag_s = np.zeros(robot.cable_count)
        model = self.judge.model
        for cable in range(robot.cable_count):
            gain = model.actuator(f"winch_{cable + 1}")
            # A winch drive with damping follows a ramp behind by kv / kp.
            self._lag_s[cable] = gain.biasprm[2] / gain.biasprm[1]
        self._steps_per_s = 1.0 / model.opt.timestep
        self._begun = False

    def __call__(
        self, paid_out_m: list[float], rates_mps: list[float], duration_s: float
    ) -> tuple[list[float], list[float], list[float]]:
        """One slice of time; see :data:`mcdpr.session.Engine`."""
        judge = self.judge
        model, data = judge.model, judge.data
        paid_out, rates = np.array(paid_out_m), np.array(rates_mps)
        if not self._begun:
            tension = judge.robot.values["tension"]["setpoint_n"]
            held = [c["control"] == "Position" for c in judge.robot.values["cables"]]
            if not all(held):
                # Nearly where it hangs, as if its cables were rigid; the springs do the rest.
                lengths = np.where(held, paid_out, np.nan)
                judge.put(judge.robot.fk_static(lengths, np.where(held, np.nan, tension)))
        model.tendon_stiffness[:] = judge._ea_n / (paid_out + judge._routing_m)
        # The demand is held through the slice: on average it leads by half of it.
        data.ctrl[:] = judge._home_m - paid_out - (self._lag_s - 0.5 * duration_s) * rates
        if not self._begun:
            self._begun = True
            if not judge.settle(2.0, speed=1e-6):
                raise RunError("MuJoCo finds no rest where the robot hangs")
            model.dof_damping[:] = judge._damping
        judge._mj.mj_step(model, data, max(1, round(duration_s * self._steps_per_s)))
        at = judge._platform
        quaternion = data.qpos[at + 3 : at + 7] / np.linalg.norm(data.qpos[at + 3 : at + 7])
        return judge.position_m.tolist(), quaternion.tolist(), judge.tensions_n.tolist()
