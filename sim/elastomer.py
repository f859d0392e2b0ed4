"""The soft pad: what it is made of, how large it is and how it is mounted."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field

from gelgap.assets import load_preset
from gelgap.assets.settings import Settings, within
from gelgap.assets.toml_file import read_toml
from gelgap.sim.material import Moduli, equivalent_moduli

StrainEnergy = Literal["isochoric", "stable-neo-hookean"]
Length = Annotated[float, within(1.0, 100.0, "mm")]


class Elastomer(Settings):
    """A pad of neo-Hookean gel bonded to a rigid backing, which a spring may carry.

    The gel's energy is `isochoric`, μ/2 (J^(−2/3) I₁ − 3) + K/2 (J − 1)², unless `stable-neo-hookean` asks for the
    energy that MuJoCo itself uses, μ/2 (I₁ − 3) − μ (J − 1) + (λ + μ)/2 (J − 1)².
    """

    young_modulus_mpa: Annotated[float, within(0.001, 100.0, "MPa")] = Field(
        description="Young's modulus at small strain, MPa, 0.001 to 100."
    )
    poisson_ratio: Annotated[float, within(0.0, 0.5, "", high_open=True)] = Field(
        description="Poisson's ratio, 0 to below 0.5."
    )
    friction: Annotated[float, within(0.0, 1000.0, "")] = Field(
        description="Coulomb friction coefficient between gel and indenter, 0 to 1000; 10 and more is no slip."
    )
    thickness_mm: Annotated[float, within(0.2, 50.0, "mm")] = Field(
        default=3.0, description="Thickness of the pad, mm, 0.2 to 50."
    )
    pad_size_mm: tuple[Length, Length] = Field(
        default=(24.0, 20.0), description="Size of the pad along x and y, mm, 1 to 100 each."
    )
    mount_stiffness_n_per_mm: Annotated[float, within(0.01, 1e6, "N/mm")] | None = Field(
        default=None,
        description="Stiffness of the spring between indenter drive and gel, the same in x, y and z, N/mm; "
        "none: a rigid rig.",
    )
    strain_energy: StrainEnergy = Field(
        default="isochoric", description="The form of the neo-Hookean energy that the two moduli refer to."
    )

    @classmethod
    def preset(cls, name: str) -> Self:
        """Return the elastomer preset of that name.

        Raises
        ------
        ValueError
            If there is no such preset; the message lists the known ones.
        """
        values = load_preset("elastomers", name)
        values.pop("description", None)
        return cls(**values)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read an elastomer TOML file: these fields, and a description if there is one.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is not valid TOML, a field is unknown or missing, or a value is out of range.
        """
        values = read_toml(path)
        values.pop("description", None)
        try:
            return cls(**values)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    @property
    def mujoco_moduli(self) -> Moduli:
        """The moduli with which MuJoCo's energy acts as this gel's."""
        own = Moduli(self.young_modulus_mpa, self.poisson_ratio)
        return equivalent_moduli(own) if self.strain_energy == "isochoric" else own
