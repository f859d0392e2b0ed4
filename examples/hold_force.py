"""
A force held by a PI law
========================

A sphere presses a gel with a target force. The law moves it by what a force gauge would read, here the simulated
sensor; a network that reads the picture could take its place.
"""

import matplotlib.pyplot as plt
import numpy as np

from gelgap.domains import TactileSensor
from gelgap.domains.environment import PressEnv


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
