#version 330 core
// The geometry buffer: rest coordinates, 0, and 1 where the membrane is.
in vec2 rest_mm;
layout(location = 0) out vec4 geometry;

void main() {
    geometry = vec4(rest_mm, 0.0, 1.0);
}
