"""`gelgap press`: press an indenter into an elastomer and print or save what the contact does."""

import json
import math
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from gelgap import render, sim, view
from gelgap.cli import options as opt
from gelgap.cli.contact_keys import body_keys, gel_keys
from gelgap.cli.keys import Meanings, Set, given

DEFAULT_GEL = {"young_modulus_mpa": 0.3, "poisson_ratio": 0.49, "friction": 0.8}
DEFAULT_DEPTH_MM = 0.6
MESH_PICTURE_PX = (640, 480)
# Fields of a body that come from its file, and are thousands of numbers.
BULKY = {"hull_mm", "above_mm", "heights"}
DIAGNOSTICS = (
    "slip",
    "sticking_fraction",
    "min_volume_ratio",
    "coarse",
    "folded",
    "force_error_n",
    "tz_error_n_mm",
    "contact_radius_error_mm",
    "membrane_error_mm",
)


@dataclass(frozen=True)
class Press(opt.Command):
    """Press an indenter straight down at one point, then drag it sideways, and report force and membrane.

    Force is what the indenter exerts on the sensor, in N: Fz < 0 under compression, dragging towards +x gives Fx > 0.

    For example:
      gelgap press --set young_modulus_mpa=0.3 poisson_ratio=0.49 --depth-mm 0.6 --shear-mm 0.3 0 --json
      gelgap press --elastomer b1 --force-n 0.5 --save state.npz
      gelgap press --depth-mm 0.5 --turn-deg 0 0 10
      gelgap press --indenter cone --set half_angle_deg=60 tip_radius_mm=0.4 friction=0.5 --traction map.npz
    """

    fills_cache = True

    elastomer: Annotated[str | None, opt.optional("NAME")] = None
    """Elastomer preset or TOML file (see: gelgap presets elastomers), of which --set changes values."""
    indenter: str = "sphere"
    """Shape (sphere, cylinder, cone, edge, box, ellipsoid), preset (gelgap presets indenters), TOML, mesh, map file."""
    set: Set = ()
    """Values of the gel and sizes of the body, named as in a TOML file; all keys are listed above."""
    depth_mm: Annotated[float | None, opt.optional("MM", "0.6, or what --force-n needs")] = None
    """Commanded depth below first contact in mm, at least 0."""
    force_n: Annotated[float | None, opt.optional("N"), opt.between(1e-6, 10_000, "N")] = None
    """Load control: press to this normal force in N (positive) instead of to a depth, then drag at that depth."""
    shear_mm: Annotated[tuple[float, float], tyro.conf.arg(metavar="X Y"), opt.between(-50, 50, "mm")] = (
        0.0,
        0.0,
    )
    """Commanded sideways travel along x and y (down in the image) after the press, in mm."""
    turn_deg: Annotated[tuple[float, float, float], tyro.conf.arg(metavar="X Y Z")] = (0.0, 0.0, 0.0)
    """Turn on the way sideways, or after the press: roll about x and y, twist about the vertical from +x towards +y, in
    degrees; about a sphere's centre, another body's lowest point."""
    point_mm: Annotated[tuple[float, float], tyro.conf.arg(metavar="X Y")] = (0.0, 0.0)
    """Contact point along x and y in mm; 0 0 is the centre of the pad."""
    quality: opt.Quality = "standard"
    """How finely mesh and load steps resolve the contact."""
    json: opt.Flag = False
    """Print one JSON object instead of a table."""
    save: Annotated[Path | None, opt.optional("PATH"), opt.OutputFile(".npz")] = None
    """Write the membrane to this .npz (x_mm, y_mm, displacement_mm, contact, force_n) for `gelgap render`."""
    traction: Annotated[Path | None, opt.optional("PATH"), opt.OutputFile(".npz")] = None
    """Write the contact stress on the membrane's grid, and the force on 24 × 32 cells, to this .npz."""
    slip: Annotated[Path | None, opt.optional("PATH"), opt.OutputFile(".npz")] = None
    """Write how far the membrane has slid over the indenter since the press straight down to this .npz."""
    mesh: Annotated[Path | None, opt.optional("PATH"), opt.OutputFile(".glb", ".ply")] = None
    """Write the membrane, with the paper sensor's picture of it under illumination i0, and the indenter as a mesh."""

    @classmethod
    def keys(cls) -> dict[str, Meanings]:
        return {"gel": gel_keys(), "body": body_keys()}

    def run(self, started: float) -> None:
        """Solve the scene and print it; `wall_s` counts from `started`, the start of the process."""
        if self.depth_mm is not None and self.force_n is not None:
            raise ValueError("depth_mm and force_n are both given: give one of them")
        values = given(self.set, self.keys())
        base = sim.Elastomer.named(self.elastomer).model_dump() if self.elastomer else DEFAULT_GEL
        elastomer = sim.Elastomer(**base | values["gel"])
        indenter = sim.load_indenter(self.indenter, **values["body"])
        roll_x_deg, roll_y_deg, twist_deg = self.turn_deg
        pose = sim.Pose(
            DEFAULT_DEPTH_MM if self.depth_mm is None else self.depth_mm,
            *self.shear_mm,
            *self.point_mm,
            roll_deg=(roll_x_deg, roll_y_deg),
            twist_deg=twist_deg,
        )
        if self.force_n is not None:
            pressed = sim.pose_for_force(elastomer, indenter, self.force_n, self.point_mm, self.quality)
            pose = replace(pose, depth_mm=pressed.depth_mm)
        state = sim.solve_pose(elastomer, indenter, pose, self.quality)
        diagnostics = state.diagnostics
        if self.save is not None:
            state.save(self.save)
        if self.traction is not None:
            state.traction().save(self.traction)
        if self.slip is not None:
            state.slip().save(self.slip)
        if self.mesh is not None:
            sensor, light = render.Sensor.preset("paper"), render.Illumination.preset("i0")
            renderer = render.MembraneRenderer(sensor, light, MESH_PICTURE_PX)
            picture = renderer.picture(state.x_mm, state.y_mm, state.displacement_mm)
            view.save_mesh(
                self.mesh, state, self.point_mm, indenter.turned(pose.turn_deg), sensor.camera, picture
            )
        report = {
            "indenter": indenter.label,
            "force_n": state.force_n.tolist(),
            "torque_n_mm": state.torque_n_mm.tolist(),
            "contact_radius_mm": float(state.contact_radius_mm),
            "converged": bool(state.converged),
            "indenter_mm": state.indenter_mm.tolist(),
            **{name: getattr(diagnostics, name) for name in DIAGNOSTICS},
            "wall_s": time.perf_counter() - started,
        }
        if self.json:
            settings = {
                "elastomer": elastomer.model_dump(mode="json"),
                "indenter": {"name": self.indenter, **indenter.model_dump(mode="json", exclude=BULKY)},
                "pose": asdict(pose),
                "quality": self.quality,
            }
            print(json.dumps(report | {"settings": settings}))
        else:
            print(self._table(pose.depth_mm, report))

    def _table(self, depth_mm: float, report: dict[str, Any]) -> str:
        force = zip("xyz", report["force_n"], report["force_error_n"], strict=True)
        torque = "  ".join(f"T{axis} {t:+.4f}" for axis, t in zip("xyz", report["torque_n_mm"], strict=True))
        radius = f"{report['contact_radius_mm']:.3f} ± {report['contact_radius_error_mm']:.3f}"
        finer = {"draft": "standard", "standard": "fine"}.get(self.quality)
        try_finer = f"try --quality {finer}" if finer else "there is no finer one"
        remedy = f"{try_finer}, less depth or travel" if finer else "try less depth or travel"
        x, y, z = report["indenter_mm"]
        came = f"the indenter came {-z:.3g} mm deep and {math.hypot(x, y):.3g} mm sideways"
        if report["min_volume_ratio"] <= 0:
            came += ", where an element of the mesh is inverted"
        rows = {
            "indenter": report["indenter"],
            "depth": f"{depth_mm:.4g} mm",
            "force": f"{'  '.join(f'F{axis} {n:+.4f} ± {e:.4f}' for axis, n, e in force)} N",
            "torque": f"{torque} ± {report['tz_error_n_mm']:.4f} N mm, contact point",
            "contact radius": f"{radius} mm",
            "membrane": f"± {1e3 * report['membrane_error_mm']:.1f} µm",
            "slip": f"{report['slip']}: {100 * report['sticking_fraction']:.0f} % of the load sticks",
            "converged": "yes" if report["converged"] else f"NO: {came}; {remedy}",
        }
        if report["folded"]:
            rows["folded"] = "the membrane lies on itself: no camera sees it; drag less, or press less deep"
        if report["coarse"]:
            rows["coarse"] = f"the force may be off by more than this quality promises; {try_finer}"
        rows["wall time"] = f"{report['wall_s']:.2f} s"
        return "\n".join(f"{what:<16}{value}" for what, value in rows.items())
