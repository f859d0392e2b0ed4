#version 330 core
// The geometry buffer: rest coordinates in mm.
in vec2 rest_mm;
layout(location = 0) out vec2 geometry;

void main() {
    geometry = rest_mm;
}
