"""Fitting a sensor to pictures of a real one, in the order in which a lab works.

1. Pictures: `pictures` (the list of presses), `taxim_sets` (published ones), `press_folder` (a folder or videos).
2. Marks: `marks` finds where a ball touches in each picture.
3. Membranes: `membranes` solves presses of the ball, `profiles` gives the membrane at any depth, `poses` places each
   press under it.
4. Fit: `start` says from which side light comes, `light` models it, `fit` fits it, `residual` keeps what is left.
5. Check: `check` predicts presses that the fit has not seen.
6. Sensor file: `sensor_file` writes the sensor and its flat field.

`calibrator` runs steps 3 to 5. `report` sums up the result; `prediction` draws presses with a fitted sensor.
"""
