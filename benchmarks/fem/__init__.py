"""The project's own finite elements, which share nothing with MuJoCo: what its contacts are compared with."""
