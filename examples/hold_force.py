"""
A force held by a PI law
========================

A sphere presses a gel with a target force: one of two tasks that :class:`PressEnv` sets in Gymnasium's form. The law
moves it by what a force gauge would read, here the simulated sensor; a network that reads the picture could take its
place.
"""

from typing import Any, Literal

import gymnasium
import matplotlib.pyplot as plt
import numpy as np
from gymnasium import spaces

from gelgap.domains import TactileSensor
from gelgap.domains.tactile import Reading

STEP_MM = 0.05
STEPS = 200


class PressEnv(gymnasium.Env):
    """Move an indenter on a gel by what the camera inside sees.

    An action is (depth, x, y), each −1 to 1: how the indenter moves, in steps of 0.05 mm. An observation has the
    picture, the indenter's place (depth, x, y) in mm and the target. `info` has force and its error in N, and the
    reading's flags.

    `hold`: press with a drawn force; the reward is minus the force's deviation over the target. `slide`: drag the gel
    sideways by a drawn travel without letting the contact slide as a whole; the reward is the travel that is gained,
    over the target. It ends when the target is reached, or with −1 when the contact slides.

    Parameters
    ----------
    sensor
        A gel under a camera.
    task
        `hold` or `slide`.
    targets
        Range from which targets are drawn: of `hold` in N, of `slide` in mm; by default a fifth to four fifths of what
        the sensor's deepest press gives, and a fifth to two fifths of its farthest drag.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012
    render_mode = "rgb_array"

    def __init__(
        self,
        sensor: TactileSensor,
        task: Literal["hold", "slide"] = "hold",
        targets: tuple[float, float] | None = None,
    ) -> None:
        if task not in ("hold", "slide"):
            raise ValueError(f"task = {task!r}: must be hold or slide")
        self.sensor, self.task = sensor, task
        ranges = sensor.library.plan.ranges
        sensor.reset()
        most = ranges.farthest_mm(ranges.deepest_mm) / 2
        if task == "hold":
            most = -float(sensor.step(ranges.deepest_mm).force_n[2])
        self.targets = targets or (0.2 * most, 0.8 * most)
        width, height = sensor.renderer.size_px
        self._least_mm, self._most_mm = np.array([[0.0, -1.0, -1.0], [ranges.deepest_mm, 1.0, 1.0]])
        self.action_space = spaces.Box(-1, 1, (3,), np.float32)
        self.observation_space = spaces.Dict(
            {
                "picture": spaces.Box(0, 255, (height, width, 3), np.uint8),
                "place_mm": spaces.Box(self._least_mm.astype(np.float32), self._most_mm.astype(np.float32)),
                "target": spaces.Box(np.float32(0), np.float32(max(self.targets)), (1,)),
            }
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict]:
        """Lift the indenter and draw a target."""
        super().reset(seed=seed)
        self.sensor.reset()
        self.target = float(self.np_random.uniform(*self.targets))
        self._place_mm, self._steps = np.zeros(3), 0
        self._touched_mm, self._travel_mm = np.zeros(2), 0.0
        self._show(self.sensor.step(0.0))
        return self._observation(), self._info()

    def step(self, action: np.ndarray) -> tuple[dict, float, bool, bool, dict]:
        """Move the indenter; a place that the sensor does not reach is refused, and it stays where it is."""
        wanted = self._place_mm + STEP_MM * np.clip(np.asarray(action, float), -1, 1)
        wanted = np.clip(wanted, self._least_mm, self._most_mm)
        before_mm, refused = self._place_mm, ""
        try:
            self._show(self.sensor.step(wanted[0], point_mm=wanted[1:]))
            if before_mm[0] == 0:
                self._touched_mm, self._travel_mm = wanted[1:], 0.0
            self._place_mm = wanted
        except ValueError as error:
            refused = str(error)
        self._steps += 1
        info = self._info() | {"refused": refused}
        if self.task == "hold":
            reward, ended = -abs(-float(self._reading.force_n[2]) - self.target) / self.target, False
        else:
            slides = "slides" in self._reading.flags
            travel_mm, before = float(np.hypot(*(self._place_mm[1:] - self._touched_mm))), self._travel_mm
            self._travel_mm, pressed = travel_mm, self._place_mm[0] > 0
            reward = -1.0 if slides else ((travel_mm - before) / self.target if pressed else 0.0)
            ended = slides or bool(pressed and travel_mm >= self.target)
        return self._observation(), float(reward), ended, self._steps >= STEPS, info

    def render(self) -> np.ndarray:
        """Return the last picture."""
        return self._picture

    def _show(self, reading: Reading) -> None:
        """Take in a reading; where the membrane folds, the last picture that could be seen stays."""
        self._reading = reading
        if reading.picture is not None:
            self._picture = reading.picture

    def _observation(self) -> dict[str, np.ndarray]:
        return {
            "picture": self._picture,
            "place_mm": self._place_mm.astype(np.float32),
            "target": np.array([self.target], np.float32),
        }

    def _info(self) -> dict[str, Any]:
        reading = self._reading
        return {
            "force_n": reading.force_n.copy(),
            "force_error_n": reading.force_error_n,
            "flags": reading.flags,
        }


def main(steps: int = 60, **settings) -> np.ndarray:
    env = PressEnv(TactileSensor("b0", **settings), "hold")
    _, info = env.reset(seed=0)
    summed, force_n = 0.0, []
    for _ in range(steps):
        missing = 1 + info["force_n"][2] / env.target
        # What is summed on the way there would carry the indenter too far.
        summed += missing if abs(missing) < 0.5 else 0.0
        _, _, _, _, info = env.step(np.array([2.0 * missing + 0.2 * summed, 0, 0]))
        force_n.append(-info["force_n"][2])
    print(f"target {env.target:.3f} N, held {force_n[-1]:.3f} N after {steps} steps")
    plt.figure(figsize=(5, 3), layout="constrained")
    plt.plot(force_n, label="Fz (N)")
    plt.axhline(env.target, color="grey", label="target")
    plt.legend()
    return np.array(force_n) / env.target


if __name__ == "__main__":
    main()
    plt.show()
