"""The project's own finite elements, which share nothing with MuJoCo: the reference for its contacts."""
