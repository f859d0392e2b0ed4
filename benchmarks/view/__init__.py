"""The page in the browser: how soon it shows what a knob changes, and the picture of it in the guides."""
