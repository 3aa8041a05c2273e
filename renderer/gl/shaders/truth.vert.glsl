#version 330 core
// One pass for depth and part numbers; positions, and what cuts holes.
layout(location = 0) in vec3 position;
uniform mat4 clip_from_part;
#if CUT
layout(location = 2) in vec2 texcoord;
layout(location = 3) in vec4 vertex_color;
out vec2 uv;
out float vertex_alpha;
#endif
void main() {
    gl_Position = clip_from_part * vec4(position, 1.0);
#if CUT
    uv = texcoord;
    vertex_alpha = vertex_color.a;
#endif
}
