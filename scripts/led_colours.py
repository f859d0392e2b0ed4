"""Make assets/led_colours.csv: what each camera of colour-science responds to the spectra that data sheets state.

    python scripts/led_colours.py

White light from 2000 to 10,000 K in steps of 100 K, and lines of 400 to 700 nm that are 15 to 40 nm wide, both in steps
of 5 nm. Each value is that of `spectra.computed_rgb`, in full precision.
"""

import csv

import colour

from gelgap.assets import asset_path
from gelgap.render.light.spectra import (
    EQUAL_ENERGY,
    TABLE,
    PeakSpectrum,
    WhiteSpectrum,
    computed_rgb,
    table_key,
)


def main() -> None:
    """Write the table."""
    white = [WhiteSpectrum(cct_k=float(cct_k)) for cct_k in range(2000, 10_001, 100)]
    lines = [
        PeakSpectrum(peak_nm=float(peak_nm), width_nm=float(width_nm))
        for peak_nm in range(400, 701, 5)
        for width_nm in range(15, 41, 5)
    ]
    with asset_path(TABLE).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("camera", "spectrum", "peak_nm or cct_k", "width_nm", "red", "green", "blue"))
        for camera in colour.MSDS_CAMERA_SENSITIVITIES:
            for spectrum in (EQUAL_ENERGY, *white, *lines):
                writer.writerow((*table_key(spectrum, camera), *computed_rgb(spectrum, camera).tolist()))


if __name__ == "__main__":
    main()
