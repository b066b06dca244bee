"""Work of the simulator node, without ROS: commands go in, messages come out."""

from dataclasses import dataclass, field

import numpy as np

from pcs_racing import load_track
from pcs_racing.envs import DriveHeadToHeadEnv
from pcs_racing.planners import Lidar
from pcs_racing_agents import watch

TIME_STEP = 0.02  # s: 50 scans and commands a second
STILL = np.zeros(2, np.float32)


@dataclass
class Simulation:
    """Race that goes on step by step with the last command of each car."""

    track: str = "Brackwater"
    #: Planner or agent of the second car; None: commands of ``/opp_drive``.
    opponent: str | None = "lattice"
    rules: str = "paper"
    seed: int = 0
    beams: int = 1080
    #: Steering (rad) and speed (m/s).
    commands: dict[str, np.ndarray] = field(init=False, default_factory=dict)
    steps: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self.env = DriveHeadToHeadEnv(
            track=self.track,
            rules=self.rules,
            opponent=self.opponent,
            time_step=TIME_STEP,
            normalized=False,
            top_speed=20.0,
            duration=3600.0,
        )
        self.circuit = load_track(self.track)
        self.lidar = Lidar(self.circuit, beams=self.beams)
        self.info = self.env.reset(seed=self.seed)[1]

    def command(self, car: int, steering: float, speed: float) -> None:
        """Keep a command until the next one; a command that is not finite is ignored."""
        if np.isfinite([steering, speed]).all():
            limits = self.env.action_space(f"car_{car}")
            self.commands[f"car_{car}"] = np.clip(
                [steering, speed], limits.low, limits.high
            ).astype(np.float32)

    def step(self) -> list[watch.RosMessage]:
        """Drive a step and return the messages after it; a race follows the last one."""
        if not self.env.agents:
            self.info, self.commands = self.env.reset()[1], {}
        actions = {agent: self.commands.get(agent, STILL) for agent in self.env.agents}
        self.info = self.env.step(actions)[4]
        self.steps += 1
        return self.messages()

    def put(self, x: float, y: float, heading: float) -> None:
        """Put the ego at a place, at rest; the other car stays. A place in a wall is refused."""
        poses = np.array(self.info["car_0"]["poses"], float)
        poses[0] = x, y, heading
        self.info, self.commands = self.env.reset(options={"poses": poses})[1], {}

    def messages(self) -> list[watch.RosMessage]:
        """Return the scans, odometry and frames of this moment; the time goes on over all races."""
        time = round(1e9 * TIME_STEP * self.steps)
        poses, velocities = (
            np.asarray(self.info["car_0"][key], float) for key in ("poses", "velocities")
        )
        cars = np.zeros((len(poses), 7))
        cars[:, [0, 1, 4]], cars[:, [3, 5, 6]] = poses, velocities
        ranges = [self.lidar.scan(poses[car], poses[1 - car]) for car in range(2)]
        scans = [watch.scan_message(self.lidar, row, car, time) for car, row in enumerate(ranges)]
        return [*scans, *watch.pose_messages(cars, time)]

    def map(self) -> watch.RosMessage:
        """Return the circuit."""
        return watch.map_message(self.circuit)
