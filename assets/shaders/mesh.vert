#version 330 core
// The deformed membrane in the camera, with radial lens distortion; carries each vertex's rest coordinates in mm.
layout(location = 0) in vec3 position;
layout(location = 1) in vec2 texcoord_0;
uniform mat4 V;
uniform mat4 P;
uniform vec2 radial_distortion;
uniform float farthest_slope;
out vec2 rest_mm;

void main() {
    vec4 eye = V * vec4(position, 1.0);
    vec2 slope = eye.xy / eye.z;
    // Out of the picture the lens may fold: from its corner on, slopes are stretched alike.
    float r2 = min(dot(slope, slope), farthest_slope * farthest_slope);
    eye.xy *= 1.0 + r2 * (radial_distortion.x + r2 * radial_distortion.y);
    rest_mm = texcoord_0;
    gl_Position = P * eye;
}
