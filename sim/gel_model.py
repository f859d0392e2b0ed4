"""The MuJoCo model of one gel under one sphere: a flex of stable neo-Hookean tetrahedra and contact at its nodes."""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.mesh import GelMesh

# With masses in tonnes and steps of 1 s, total mass / (E · thickness · step²) near 1 makes each step one damped
# Newton iteration of a static problem: much less leaves MuJoCo's solver without metric, much more slows it down.
_MASS_RATIO = 0.33
_HEAVY = 1e7
_LOCKED = 1e12
# The contact's inverse weights, scaled so that contacts are stiff against the gel's static stiffness.
_INVWEIGHT_SCALE = 1e-3
# Nodes this near the ball are constrained not to enter it.
_NEAR = 0.2
_CONTACT = 'solref="1e-3 1" solimp="0.9999 0.9999 0.001 0.5 2"'


@dataclass(frozen=True)
class GelModel:
    """A compiled model, what it is made of, and where its parts are.

    `vertex_dof` is each mesh vertex's first dof, −1 if bonded.
    """

    model: Any
    mesh: GelMesh
    young_modulus_mpa: float
    poisson_ratio: float
    vertex_dof: NDArray[np.int64]
    vertex_of_geom: NDArray[np.int64]
    ball_dof: slice
    ball_qpos: slice
    ball_geom: int


def build_gel_model(
    mesh: GelMesh,
    *,
    young_modulus_mpa: float,
    poisson_ratio: float,
    friction: float,
    sphere_radius_mm: float,
    contact_zone_mm: float,
    mount_stiffness_n_per_mm: float | None,
) -> GelModel:
    """Compile the model. Nodes of the membrane within `contact_zone_mm` of the axis can touch the sphere."""
    import mujoco

    mujoco.set_mju_user_warning(_ignore_warning)
    thickness = -float(mesh.vertices_mm[:, 2].min())
    spec = mujoco.MjSpec.from_string(
        _xml(
            mesh,
            young_modulus_mpa=young_modulus_mpa,
            poisson_ratio=poisson_ratio,
            friction=friction,
            radius_mm=sphere_radius_mm,
            gel_mass=_MASS_RATIO * young_modulus_mpa * thickness,
            # Half a gel carries half the force, and its half of the spring.
            mount_stiffness=mount_stiffness_n_per_mm and mount_stiffness_n_per_mm / (2 if mesh.half else 1),
        )
    )
    for flex in spec.flexes:
        flex.elastic3d = 1
    surface = mesh.surface
    touching = surface[np.hypot(*mesh.vertices_mm[surface, :2].T) <= contact_zone_mm]
    bodies = {body.name: body for body in spec.bodies}
    for vertex in touching:
        bodies[f"gel_{vertex}"].add_geom(
            name=f"node_{vertex}",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[1e-5, 0, 0],
            mass=0,
            contype=2,
            conaffinity=1,
            condim=3,
        )
    with warnings.catch_warnings():
        # The compiler does not see that the flex is elastic through its strain energy alone.
        warnings.filterwarnings("ignore", message=".*has no equality constraints or passive forces.*")
        model = spec.compile()
    body = model.flex_vertbodyid
    moving = (body > 0) & (model.body_dofnum[body] == 3)
    vertex_dof = np.where(moving, model.body_dofadr[body], -1)
    first_dof, first_qpos = model.joint("ball_x").dofadr[0], model.joint("ball_x").qposadr[0]
    if mesh.half:
        on_plane = np.intersect1d(mesh.symmetry_plane, np.flatnonzero(moving))
        across = np.append(vertex_dof[on_plane], first_dof) + 1
        # Point masses take their inertia from dof_M0, which the compiler has filled.
        model.dof_armature[across] = _LOCKED
        model.dof_M0[across] = _LOCKED
    model.body_invweight0[:] *= _INVWEIGHT_SCALE
    model.dof_invweight0[:] *= _INVWEIGHT_SCALE
    vertex_of_geom = np.full(model.ngeom, -1)
    for vertex in touching:
        vertex_of_geom[model.geom(f"node_{vertex}").id] = vertex
    return GelModel(
        model=model,
        mesh=mesh,
        young_modulus_mpa=young_modulus_mpa,
        poisson_ratio=poisson_ratio,
        vertex_dof=vertex_dof,
        vertex_of_geom=vertex_of_geom,
        ball_dof=slice(first_dof, first_dof + 3),
        ball_qpos=slice(first_qpos, first_qpos + 3),
        ball_geom=model.geom("ball").id,
    )


def _ignore_warning(message: str) -> None:
    """MuJoCo's warnings would go to a log file in the user's folder; `mjData.warning` counts them for us."""


def _xml(
    mesh: GelMesh,
    *,
    young_modulus_mpa: float,
    poisson_ratio: float,
    friction: float,
    radius_mm: float,
    gel_mass: float,
    mount_stiffness: float | None,
) -> str:
    points = " ".join(f"{value:.17g}" for value in mesh.vertices_mm.ravel())
    elements = " ".join(map(str, mesh.tetrahedra.ravel()))
    pinned = " ".join(map(str, mesh.bottom))
    # A rigid drive is a ball too heavy for the gel to move; a compliant one is a light ball on springs.
    ball_mass = _HEAVY if mount_stiffness is None else 1e-3 * gel_mass
    spring = "" if mount_stiffness is None else f'stiffness="{mount_stiffness:.12g}"'
    joints = "".join(
        f'<joint name="ball_{name}" type="slide" axis="{axis}" {spring}/>'
        for name, axis in (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1"))
    )
    return f"""<mujoco>
  <option timestep="1" gravity="0 0 0" integrator="discrete" solver="Newton" iterations="30" ls_iterations="50"
          tolerance="0" cone="elliptic" jacobian="sparse"><flag refsafe="disable"/></option>
  <size memory="4G"/>
  <worldbody>
    <body name="ball" pos="0 0 {radius_mm:.12g}">{joints}
      <geom name="ball" type="sphere" size="{radius_mm:.12g}" mass="{ball_mass:.12g}" contype="1" conaffinity="2"
            condim="3" friction="{friction:.12g} 0 0" {_CONTACT} priority="1" margin="{_NEAR:.12g}"/>
    </body>
    <flexcomp name="gel" type="direct" dim="3" dof="full" mass="{gel_mass:.12g}" radius="1e-6" inertiabox="1e-3"
              point="{points}" element="{elements}">
      <pin id="{pinned}"/>
      <contact selfcollide="none" contype="0" conaffinity="0"/>
      <edge equality="false"/>
      <elasticity young="{young_modulus_mpa:.12g}" poisson="{poisson_ratio:.12g}"/>
    </flexcomp>
  </worldbody>
</mujoco>"""
