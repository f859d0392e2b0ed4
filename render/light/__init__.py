"""The light on the membrane: LEDs and their spectra, irradiance with soft shadows, gloss, and scattered light."""
