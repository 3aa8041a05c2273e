#version 330 core
// One pass for depth and part numbers; positions only.
layout(location = 0) in vec3 position;
uniform mat4 clip_from_part;
void main() { gl_Position = clip_from_part * vec4(position, 1.0); }
