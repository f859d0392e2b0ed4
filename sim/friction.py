"""The contacts of MuJoCo's iterations, and Coulomb's law of a load step imposed on them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.indenters.base import Indenter
from gelgap.sim.mujoco_model import GelModel
from gelgap.sim.thresholds import THRESHOLDS

# MuJoCo wants some friction at every contact; nodes that are not held get this.
_FRICTIONLESS = 1e-5


class FrictionalContacts:
    """The contacts in MuJoCo's data; arrays have an entry per contact, in MuJoCo's order.

    Friction acts against the slip since the load step's start: Coulomb's law of a load step (backward Euler) is about
    this slip and not that of one iteration. A node is active if the last iteration pressed it. Nodes that are active
    when the step begins stick from where they are then. A node that becomes active within the step has landed, on
    average half way: its slip counts from half way between its position at the start of the step and the one that it
    reached without friction. Other nodes slide freely.
    """

    def __init__(self, gel: GelModel, data: Any, indenter: Indenter, friction: float) -> None:
        self._gel = gel
        self._data = data
        self._indenter = indenter
        self._friction = friction
        self._start_mm: NDArray[np.float64] | None = None
        self._anchor_mm = np.zeros((0, 3))
        self._held = self._landed = np.zeros(0, dtype=bool)

    @property
    def nodes(self) -> NDArray[np.int64]:
        """Each contact's node."""
        geoms = self._data.contact.geom
        return np.where(geoms[:, 0] == self._gel.indenter_geom, geoms[:, 1], geoms[:, 0])

    @property
    def normal_force_n(self) -> NDArray[np.float64]:
        return self._forces_n()[:, 0]

    @property
    def loaded(self) -> NDArray[np.bool_]:
        """Whether each contact bears more than a negligible share of the largest normal force."""
        normal = self.normal_force_n
        return normal > THRESHOLDS.negligible_load_share * normal.max(initial=0.0)

    def begin_load_step(self) -> None:
        """Forget the last load step; the new one starts where the next contacts are found."""
        self._start_mm = None

    def impose_friction(self, active: NDArray[np.bool_]) -> None:
        """Write into MuJoCo's contacts what makes its friction act as Coulomb's law of the load step.

        A contact's surface velocity is added to its friction rows; as an iteration takes 1 s, it stands for the slip so
        far. MuJoCo's convex friction cone lets a node that slides by s rise by μ s (Anitescu 2006, Math.
        Program. 105:113). The gap is widened by as much, so that a settled node slides on the indenter (the fixed point
        of De Saxcé & Feng 1998, Math. Comput. Model. 28:225).
        """
        data, nodes, place_mm = self._data, self.nodes, self._places_mm()
        if self._start_mm is None:
            self._start_mm, self._anchor_mm, self._held = place_mm, place_mm.copy(), active.copy()
        self._landed = active & ~self._held
        self._anchor_mm[self._landed] = (self._start_mm + place_mm)[self._landed] / 2
        self._held |= self._landed
        held = self._held[nodes]
        tangents = data.contact.frame.reshape(-1, 3, 3)[:, 1:]
        slip_mm = np.einsum("nij,nj->ni", tangents, (place_mm - self._anchor_mm)[nodes]) * self._sign()
        slip_mm[~held] = 0.0
        data.contact.surfacevel[:, :2] = slip_mm
        # Most nodes that landed go back and stick; a widened gap would press them into the indenter.
        slides_mm = np.where(self._landed[nodes], 0.0, np.linalg.norm(slip_mm, axis=1))
        data.contact.dist[:] += self._friction * slides_mm
        data.contact.friction[~held, :2] = _FRICTIONLESS

    def at_rest(self) -> bool:
        """Return whether all nodes with load are held, and none of them landed in the last iteration."""
        return bool((self._held & ~self._landed)[self.nodes[self.loaded]].all())

    def coulomb_excess(self) -> float:
        """Return the largest |f_t| / (μ f_n) − 1 of loaded contacts; −1 without friction.

        Friction was bounded along the normals that the iteration began with; where nodes have gone on, normals have
        turned.
        """
        data, gel, loaded = self._data, self._gel, self.loaded
        if not loaded.any() or self._friction == 0:
            return -1.0
        nodes = self.nodes[loaded]
        moved = data.qvel[gel.dofs(nodes)].reshape(-1, 3) - data.qvel[gel.indenter_dof]
        normal = self._indenter.project(self._places_mm()[nodes] + moved).outward_normal
        frames = data.contact.frame.reshape(-1, 3, 3)
        force = (np.einsum("ni,nij->nj", self._forces_n(), frames) * self._sign())[loaded]
        normal_force = np.einsum("ni,ni->n", force, normal)
        tangential_force = np.linalg.norm(force - normal_force[:, None] * normal, axis=1)
        return float((tangential_force / (self._friction * normal_force)).max()) - 1

    def sticking_fraction(self) -> float:
        """Return the share of the normal force on nodes whose friction is below its limit."""
        forces = self._forces_n()
        normal = forces[:, 0]
        if not normal.sum() > 0:
            return 1.0
        limit = THRESHOLDS.sticking_share * self._friction * normal
        sticks = np.linalg.norm(forces[:, 1:], axis=1) < limit
        return float(1.0 - normal[~sticks].sum() / normal.sum())

    def vertex_normal_force_n(self) -> NDArray[np.float64]:
        """Return the normal force on each vertex of the mesh."""
        forces = np.zeros(len(self._gel.mesh.vertices_mm))
        forces[self._gel.vertex_of_geom[self.nodes]] = self.normal_force_n
        return forces

    def _forces_n(self) -> NDArray[np.float64]:
        """Return each contact's force along its normal and two tangents, (contacts, 3)."""
        return self._data.efc_force[: 3 * self._data.ncon].reshape(-1, 3)

    def _sign(self) -> NDArray[np.float64]:
        """Return 1 where a contact's frame leads from the indenter to the node, −1 where it leads back, (contacts, 1).

        MuJoCo orders the two geoms of a contact by their types.
        """
        return np.where(self._data.contact.geom[:, :1] == self._gel.indenter_geom, 1.0, -1.0)

    def _places_mm(self) -> NDArray[np.float64]:
        """Return where all geoms lie, from the indenter's origin, (geoms, 3)."""
        return self._data.geom_xpos - self._data.geom_xpos[self._gel.indenter_geom]
