"""`gelgap press`: press an indenter into an elastomer and print or save what the contact does."""

import json
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from gelgap import render, sim, view
from gelgap.cli import options as opt

DEFAULT_GEL = {"young_modulus_mpa": 0.3, "poisson_ratio": 0.49, "friction": 0.8}
DEFAULT_DEPTH_MM = 0.6
MESH_PICTURE_PX = (640, 480)
DIAGNOSTICS = (
    "slip",
    "sticking_fraction",
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
      gelgap press --young-modulus-mpa 0.3 --poisson-ratio 0.49 --depth-mm 0.6 --shear-x-mm 0.3 --json
      gelgap press --elastomer b1 --force-n 0.5 --save state.npz
      gelgap press --depth-mm 0.5 --twist-deg 10
      gelgap press --indenter cone --half-angle-deg 60 --tip-radius-mm 0.4 --depth-mm 0.5 --traction map.npz
    """

    fills_cache = True

    elastomer: Annotated[str | None, opt.optional("NAME")] = None
    """Elastomer preset or TOML file to start from (see: gelgap presets elastomers); the values below override it."""
    young_modulus_mpa: Annotated[float | None, opt.optional("MPA", "0.3, or the preset's")] = None
    """Young's modulus in MPa."""
    poisson_ratio: Annotated[float | None, opt.optional("NU", "0.49, or the preset's")] = None
    """Poisson's ratio, below 0.5."""
    thickness_mm: Annotated[float | None, opt.optional("MM", "3, or the preset's")] = None
    """Thickness of the pad in mm."""
    friction: Annotated[float | None, opt.optional("MU", "0.8, or the preset's")] = None
    """Coulomb friction coefficient between indenter and membrane."""
    static_friction: Annotated[float | None, opt.optional("MU", "friction, or the preset's")] = None
    """Friction coefficient before slip, at least --friction, to which it falls over 0.05 mm of slip."""
    pad_size_mm: Annotated[tuple[float, float] | None, opt.optional("MM MM", "24 20, or the preset's")] = None
    """Size of the pad along x and y in mm."""
    mount_stiffness_n_per_mm: Annotated[float | None, opt.optional("N/MM", "rigid, or the preset's")] = None
    """Stiffness of the rig, a spring in series with the gel, in N/mm."""
    strain_energy: Annotated[
        str | None, opt.optional("{isochoric,stable-neo-hookean}", "isochoric, or the preset's")
    ] = None
    """Form of the neo-Hookean energy: isochoric, as silicone behaves, or MuJoCo's own."""
    body: Annotated[opt.IndenterOptions, tyro.conf.OmitArgPrefixes] = opt.SPHERE
    depth_mm: Annotated[float | None, opt.optional("MM", "0.6, or what --force-n needs")] = None
    """Commanded depth below first contact in mm, at least 0."""
    normal_force_n: Annotated[
        float | None, opt.optional("N", aliases=("--force-n",)), opt.between(1e-6, 1e4, "N")
    ] = None
    """Load control: press to this normal force in N (positive) instead of to a depth, then drag at that depth."""
    shear_x_mm: Annotated[float, opt.between(-50, 50, "mm")] = 0.0
    """Commanded sideways travel along x after the press, in mm."""
    shear_y_mm: Annotated[float, opt.between(-50, 50, "mm")] = 0.0
    """Commanded sideways travel along y (down in the image) after the press, in mm."""
    twist_deg: float = 0.0
    """Turn of the indenter about the vertical on its way sideways, or after the press, degrees from +x towards +y."""
    roll_deg: tuple[float, float] = (0.0, 0.0)
    """Turn about x and y on the same way, in degrees: about a sphere's centre, another body's lowest point."""
    point_x_mm: float = 0.0
    """Contact point along x in mm; 0 is the centre of the pad."""
    point_y_mm: float = 0.0
    """Contact point along y in mm."""
    quality: opt.Quality = "standard"
    """How finely mesh and load steps resolve the contact."""
    json: opt.Flag = False
    """Print one JSON object instead of a table."""
    save: Annotated[Path | None, opt.optional("PATH"), opt.output_file()] = None
    """Write the membrane to this .npz (x_mm, y_mm, displacement_mm, contact, force_n) for `gelgap render`."""
    traction: Annotated[Path | None, opt.optional("PATH"), opt.output_file(".npz")] = None
    """Write the contact stress on the membrane's grid, and the force on 24 × 32 cells, to this .npz."""
    slip: Annotated[Path | None, opt.optional("PATH"), opt.output_file(".npz")] = None
    """Write how far the membrane has slid over the indenter since the press straight down to this .npz."""
    mesh: Annotated[Path | None, opt.optional("PATH"), opt.output_file(".glb", ".ply")] = None
    """Write the membrane, with the paper sensor's picture of it under illumination i0, and the indenter as a mesh."""

    def run(self, started: float) -> None:
        """Solve the scene and print it; `wall_s` counts from `started`, the start of the process."""
        if self.depth_mm is not None and self.normal_force_n is not None:
            raise ValueError("depth_mm and normal_force_n are both given: give one of them")
        base = opt.named(sim.Elastomer, self.elastomer).model_dump() if self.elastomer else DEFAULT_GEL
        elastomer = sim.Elastomer(**base | self._given(sim.Elastomer.model_fields))
        indenter = self.body.make()
        pose = sim.Pose(**{"depth_mm": DEFAULT_DEPTH_MM} | self._given(sim.Pose.__dataclass_fields__))
        point_mm = (pose.point_x_mm, pose.point_y_mm)
        if self.normal_force_n is not None:
            pressed = sim.pose_for_force(elastomer, indenter, self.normal_force_n, point_mm, self.quality)
            pose = replace(pose, depth_mm=pressed.depth_mm)
        state = sim.solve_pose(elastomer, indenter, pose, self.quality)
        found = state.diagnostics
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
            view.save_mesh(self.mesh, state, point_mm, indenter.turned(pose.turn_deg), sensor.camera, picture)
        report = {
            "indenter": indenter.label,
            "force_n": state.force_n.tolist(),
            "torque_n_mm": state.torque_n_mm.tolist(),
            "contact_radius_mm": float(state.contact_radius_mm),
            "converged": bool(state.converged),
            **{name: getattr(found, name) for name in DIAGNOSTICS},
            "wall_s": time.perf_counter() - started,
        }
        if self.json:
            settings = {
                "elastomer": elastomer.model_dump(mode="json"),
                "indenter": indenter.model_dump(mode="json"),
                "pose": asdict(pose),
                "quality": self.quality,
            }
            print(json.dumps(report | {"settings": settings}))
        else:
            print(self._table(pose.depth_mm, report))

    def _given(self, names: Iterable[str]) -> dict[str, Any]:
        """Return the options of these names that are set."""
        return {name: value for name in names if (value := getattr(self, name, None)) is not None}

    def _table(self, depth_mm: float, report: dict[str, Any]) -> str:
        force = zip("xyz", report["force_n"], report["force_error_n"], strict=True)
        torque = "  ".join(f"T{axis} {t:+.4f}" for axis, t in zip("xyz", report["torque_n_mm"], strict=True))
        radius = f"{report['contact_radius_mm']:.3f} ± {report['contact_radius_error_mm']:.3f}"
        rows = {
            "indenter": report["indenter"],
            "depth": f"{depth_mm:.4g} mm",
            "force": f"{'  '.join(f'F{axis} {n:+.4f} ± {e:.4f}' for axis, n, e in force)} N",
            "torque": f"{torque} ± {report['tz_error_n_mm']:.4f} N mm, contact point",
            "contact radius": f"{radius} mm",
            "membrane": f"± {1e3 * report['membrane_error_mm']:.1f} µm",
            "slip": f"{report['slip']}: {100 * report['sticking_fraction']:.0f} % of the load sticks",
            "converged": "yes" if report["converged"] else "NO: do not trust these figures",
        }
        if report["folded"]:
            rows["folded"] = "the membrane lies on itself: no camera sees it; drag less, or press less deep"
        if report["coarse"]:
            finer = {"draft": "try --quality standard", "standard": "try --quality fine"}
            advice = finer.get(self.quality, "there is no finer one")
            rows["coarse"] = f"the force may be off by more than this quality promises; {advice}"
        rows["wall time"] = f"{report['wall_s']:.2f} s"
        return "\n".join(f"{what:<16}{value}" for what, value in rows.items())
