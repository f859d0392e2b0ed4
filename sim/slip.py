"""How far the membrane has slid over the indenter, from one pose of a contact to a later one."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gelgap.assets.names import one_line
from gelgap.sim.indenter import Floats, Indenter, rotation
from gelgap.sim.plan import SolvePlan, plan_visit
from gelgap.sim.scene import Elastomer, Pose
from gelgap.sim.solution import Solution


@dataclass(frozen=True, eq=False)
class Slip:
    """How far the membrane has slid over the indenter since an earlier pose, on the rest grid.

    `slip_mm` (ny, nx, 3) is in the sensor's axes, and NaN where the membrane does not touch the indenter at both poses.
    It is net slip: what went and came back is none. At the contact's rim, where the grid is finer than the mesh, it is
    uncertain by some hundredths of a millimetre.
    """

    __repr__ = one_line

    x_mm: Floats
    y_mm: Floats
    slip_mm: Floats

    def save(self, path: str | Path) -> None:
        """Write an npz of x_mm, y_mm and slip_mm."""
        with Path(path).open("wb") as file:
            np.savez_compressed(file, x_mm=self.x_mm, y_mm=self.y_mm, slip_mm=self.slip_mm)


def slip_between(plan: SolvePlan, before: int, after: int, solution: Solution | None) -> Slip:
    """Return how far the membrane has slid over the indenter between two poses that one solve visits.

    Where the membrane sticks, it goes where the indenter's travel and turn carry it; slip is how far it is from there.

    Raises
    ------
    ValueError
        If a pose makes no contact.
    """
    for pose in (before, after):
        if plan.placements[pose] is None:
            raise ValueError(f"depth_mm = {plan.poses[pose].depth_mm:g}: a pose without contact has no slip")
    first = plan.state(before, solution)
    then = plan.state(after, solution, (first.x_mm[-1], first.y_mm[-1]))
    if then.contact.shape != first.contact.shape:
        first = plan.state(before, solution, (then.x_mm[-1], then.y_mm[-1]))
    (origin_mm, turn), (origin_then_mm, turn_then) = (
        _stand(plan, pose, solution) for pose in (before, after)
    )
    carried_mm = origin_then_mm + (first.places_mm - origin_mm) @ (turn_then @ turn.T).T
    touching = first.contact & then.contact
    slip_mm = np.where(touching[..., None], then.places_mm - carried_mm, np.nan)
    return Slip(then.x_mm, then.y_mm, slip_mm)


def _stand(plan: SolvePlan, pose_index: int, solution: Solution) -> tuple[Floats, Floats]:
    """Return where an indenter's origin is (3,), and how it is turned (3, 3), on the sensor."""
    pose, placement = plan.poses[pose_index], plan.placements[pose_index]
    height_mm = plan.indenter.turned(pose.turn_deg).origin_height_mm
    travel_mm = placement.frame.on_sensor(solution.records[placement.record].indenter_mm)
    origin_mm = travel_mm + np.array([pose.point_x_mm, pose.point_y_mm, height_mm])
    return origin_mm, rotation(np.array(pose.turn_deg))


def solve_slip(elastomer: Elastomer, indenter: Indenter, pose: Pose, quality: str = "standard") -> Slip:
    """Solve a pose, the same solve as that of `solve_pose`, and return its slip since the press: see `slip_between`.

    Raises
    ------
    ValueError
        If the pose makes no contact, lies off the pad or deeper than it allows, or there is no such quality.
    """
    press = replace(pose, shear_x_mm=0.0, shear_y_mm=0.0, twist_deg=0.0, roll_deg=(0.0, 0.0))
    plan = plan_visit(elastomer, indenter, (press, pose), quality)
    return slip_between(plan, 0, 1, plan.solves[0].run() if plan.solves else None)
