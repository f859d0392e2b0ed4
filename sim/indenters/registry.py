"""The shapes of indenters: a new one joins the line below."""

from gelgap.sim.indenters.sphere import Sphere

AnyIndenter = Sphere
"""Type of a field that holds any shape, `Sphere | …`; pydantic tells shapes apart by the names of their fields."""
