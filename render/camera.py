"""The camera inside the sensor: its geometry, and what its pixels do to light."""

from pydantic import Field

from gelgap.assets.pinhole import Pinhole

Point = tuple[float, float, float]


class Camera(Pinhole):
    """A camera that looks along +z at the membrane; its optical axis meets the picture's centre."""

    vignetting: float = Field(
        default=0.0,
        ge=0,
        le=0.9,
        description="relative loss of light in the picture's corner, growing with r²",
    )
    point_spread_px: float = Field(
        default=0.0,
        ge=0,
        le=5,
        description="standard deviation of the point spread, in pixels of a 320 px wide picture",
    )
    full_well_electrons: float = Field(
        default=10_000.0, ge=100, le=1e6, description="electrons at linear value 1: sets the shot noise"
    )
    read_noise_electrons: float = Field(
        default=10.0, ge=0, le=1e4, description="standard deviation of the read noise, electrons"
    )
    exposure: float = Field(
        default=1.0, gt=0, le=1000, description="linear value per unit of camera radiance"
    )
    sensitivity: str = Field(
        default="Nikon 5100 (NPL)",
        description="spectral sensitivities, a name of colour.MSDS_CAMERA_SENSITIVITIES",
    )
    white_balance_cct_k: float | None = Field(
        default=None,
        ge=1000,
        le=25000,
        description="light that looks neutral, kelvin; none: equal-energy white",
    )
