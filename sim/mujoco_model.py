"""The MuJoCo model of a gel under an indenter: a flex of Stable Neo-Hookean tetrahedra, and contact at its vertices."""

import warnings
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gelgap.sim.mesh import GelMesh, mesh_for, touchable
from gelgap.sim.problem import ContactProblem
from gelgap.sim.scene import Moduli

# Mass in tonnes over E · thickness · step², with steps of 1 s: by how much a step, a Newton iteration of the static
# problem, is damped. With 0.33 an increment is 0.2 to 0.3 of the last one at best; 0.0033 gains no more.
_MASS_RATIO = 0.033
# A rigid drive is an indenter too heavy for the gel to move; a mounted one has this share of the gel's mass.
_RIGID_MASS_T = 1e7
_MOUNTED_MASS_RATIO = 1e-3
# Inertia of what must not leave the plane of symmetry.
_PLANE_INERTIA_T = 1e12
# Contacts give way by this over the gel's static stiffness. MuJoCo takes it from inverse masses: where contacts of a
# lighter gel were softer, friction of a slide did not settle.
_CONTACT_COMPLIANCE = 3e-3
# Vertices this near the indenter are constrained not to enter it.
_CONTACT_MARGIN_MM = 0.2
# Vertices have no extent; MuJoCo wants some inertia, which nothing turns: that of a box of half this edge.
_INERTIA_BOX_MM = 1e-3
_BODIES_PER_PART = 200
NODE_RADIUS_MM = 1e-5
_NODE = f'type="sphere" size="{NODE_RADIUS_MM}" mass="0" contype="2" conaffinity="1" condim="3"'
_CONTACT = 'solref="1e-3 1" solimp="0.9999 0.9999 0.001 0.5 2"'


@dataclass(frozen=True)
class GelModel:
    """A compiled model, its mesh, and where its parts are; all joints are slides, whose places are numbered as dofs.

    A node is a vertex of the membrane that can touch the indenter; it has a geom in MuJoCo and is known by that geom's
    number. `vertex_dof` is each mesh vertex's first dof, −1 if bonded; `vertex_of_geom` −1 for other geoms.
    """

    model: Any
    mesh: GelMesh
    vertex_dof: NDArray[np.int64]
    vertex_of_geom: NDArray[np.int64]
    indenter_dof: slice
    indenter_geom: int
    indenter_body: int


def build_gel_model(problem: ContactProblem) -> GelModel:
    """Compile the model of a problem on its mesh."""
    # Warnings would go to a log file in the user's folder; `mjData.warning` counts them all the same.
    mujoco.set_mju_user_warning(lambda message: None)
    mesh, moduli = mesh_for(problem), problem.mesh_moduli
    gel_mass_t = _MASS_RATIO * moduli.young_modulus_mpa * problem.thickness_mm
    spec = mujoco.MjSpec.from_string(_indenter_xml(problem, mesh.symmetric, gel_mass_t))
    nodes = touchable(mesh, problem)
    _add_gel(spec, mesh, moduli, gel_mass_t, nodes)
    with warnings.catch_warnings():
        # The compiler does not see that the flex is elastic through its strain energy alone.
        warnings.filterwarnings("ignore", message=".*has no equality constraints or passive forces.*")
        model = spec.compile()
    body = model.flex_vertbodyid
    moving = (body > 0) & (model.body_dofnum[body] == 3)
    vertex_dof = np.where(moving, model.body_dofadr[body], -1)
    first_dof = model.joint("indenter_x").dofadr[0]
    if mesh.symmetric:
        on_plane = np.intersect1d(mesh.symmetry_plane, np.flatnonzero(moving))
        across = np.append(vertex_dof[on_plane], first_dof) + 1
        # Point masses take their inertia from dof_M0, which the compiler has filled.
        model.dof_armature[across] = _PLANE_INERTIA_T
        model.dof_M0[across] = _PLANE_INERTIA_T
    model.body_invweight0[:] *= _CONTACT_COMPLIANCE * _MASS_RATIO
    model.dof_invweight0[:] *= _CONTACT_COMPLIANCE * _MASS_RATIO
    # MuJoCo adds each contact's surface velocity to its friction rows only if some geom seems to have one.
    model.flg_surfacevel = True
    vertex_of_geom = np.full(model.ngeom, -1)
    for vertex in nodes:
        vertex_of_geom[model.geom(f"gel_node_{vertex}").id] = vertex
    return GelModel(
        model=model,
        mesh=mesh,
        vertex_dof=vertex_dof,
        vertex_of_geom=vertex_of_geom,
        indenter_dof=slice(first_dof, first_dof + 3),
        indenter_geom=model.geom("indenter").id,
        indenter_body=model.body("indenter").id,
    )


def _add_gel(spec: Any, mesh: GelMesh, moduli: Moduli, gel_mass_t: float, nodes: NDArray[np.int64]) -> None:
    """Add the flex, a body with three slides per vertex that is not bonded, and a tiny geom at each node."""
    bonded, is_node = (np.isin(np.arange(len(mesh.vertices_mm)), some) for some in (mesh.bottom, nodes))
    moving, mass_t = np.flatnonzero(~bonded), gel_mass_t / len(bonded)
    # In each step MuJoCo sorts every vertex's neighbours by their dofs, by insertion: fast if they come nearly sorted.
    moving = moving[np.lexsort(mesh.vertices_mm[moving].T)]
    place = np.full(len(bonded), len(moving))
    place[moving] = np.arange(len(moving))
    elements = mesh.tetrahedra[np.lexsort(np.sort(place[mesh.tetrahedra], axis=1)[:, ::-1].T)]
    # Adding a body takes as long as its model has bodies, so that parts of the gel are models of their own at first.
    for part in np.array_split(moving, len(moving) // _BODIES_PER_PART + 1):
        bodies = "".join(_body_xml(vertex, mesh, mass_t, is_node[vertex]) for vertex in part)
        own = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
        spec.attach(own, frame=spec.worldbody.add_frame(), prefix="gel_")
    spec.add_flex(
        name="gel",
        dim=3,
        radius=1e-6,
        contype=0,
        conaffinity=0,
        selfcollide=mujoco.mjtFlexSelf.mjFLEXSELF_NONE,
        elastic3d=1,
        young=moduli.young_modulus_mpa,
        poisson=moduli.poisson_ratio,
        vertbody=["world" if own else f"gel_{vertex}" for vertex, own in enumerate(bonded)],
        vert=np.where(bonded[:, None], mesh.vertices_mm, 0.0).ravel(),
        elem=elements.ravel(),
    )


def _body_xml(vertex: int, mesh: GelMesh, mass_t: float, is_node: bool) -> str:
    x, y, z = mesh.vertices_mm[vertex].tolist()
    inertia = 2 / 3 * mass_t * _INERTIA_BOX_MM**2
    geom = f'<geom name="node_{vertex}" {_NODE}/>' if is_node else ""
    return f"""<body name="{vertex}" pos="{x} {y} {z}">
      <inertial pos="0 0 0" mass="{mass_t}" diaginertia="{inertia} {inertia} {inertia}"/>
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="slide" axis="0 0 1"/>{geom}
    </body>"""


def _geom_xml(problem: ContactProblem) -> str:
    """Return the attributes of the indenter's geom: those of a box around all that it fills as it turns, if it does."""
    bodies = [body for body, _ in problem.stands]
    if len(bodies) == 1:
        return bodies[0].mujoco_geom
    reach_mm = np.max([body.reach_mm(np.concatenate([np.eye(3), -np.eye(3)])) for body in bodies], axis=0)
    half, centre = (reach_mm[:3] + reach_mm[3:]) / 2, (reach_mm[:3] - reach_mm[3:]) / 2
    size, place = (" ".join(f"{value:.12g}" for value in values) for values in (half, centre))
    return f'type="box" size="{size}" pos="{place}"'


def _indenter_xml(problem: ContactProblem, symmetric: bool, gel_mass_t: float) -> str:
    mass, spring = _RIGID_MASS_T, ""
    if problem.mount_stiffness_n_per_mm is not None:
        # Half a gel carries half the force, and its half of the spring.
        stiffness = problem.mount_stiffness_n_per_mm / (2 if symmetric else 1)
        mass, spring = _MOUNTED_MASS_RATIO * gel_mass_t, f'stiffness="{stiffness:.12g}"'
    joints = "".join(
        f'<joint name="indenter_{name}" type="slide" axis="{axis}" {spring}/>'
        for name, axis in (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1"))
    )
    # MuJoCo only checks solutions: conjugate gradients factorise nothing where it refuses one.
    return f"""<mujoco>
  <option timestep="1" gravity="0 0 0" integrator="discrete" solver="CG" iterations="1" cone="elliptic"
          jacobian="sparse"><flag refsafe="disable"/></option>
  <size memory="4G"/>
  <worldbody>
    <body name="indenter" pos="0 0 {problem.indenter.origin_height_mm:.12g}">{joints}
      <geom name="indenter" {_geom_xml(problem)} mass="{mass:.12g}" contype="1" conaffinity="2"
            condim="3" friction="{problem.friction:.12g} 0 0" {_CONTACT} priority="1"
            margin="{_CONTACT_MARGIN_MM:.12g}"/>
    </body>
  </worldbody>
</mujoco>"""
