#version 330 core
// pyrender's mesh.vert without its matrix inverse per vertex: poses here are rigid, so the
// rotation itself turns normals. Names are those that pyrender's mesh.frag reads.
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 texcoord;
layout(location = 3) in vec4 vertex_color;
uniform mat4 clip_from_part;
uniform mat4 world_from_part;
uniform vec2 uv_scale;
out vec3 frag_position;
out vec3 frag_normal;
#ifdef TEXCOORD_0_LOC
out vec2 uv_0;
#endif
#ifdef COLOR_0_LOC
out vec4 color_multiplier;
#endif
void main() {
    gl_Position = clip_from_part * vec4(position, 1.0);
    frag_position = vec3(world_from_part * vec4(position, 1.0));
    frag_normal = mat3(world_from_part) * normal;
#ifdef TEXCOORD_0_LOC
    uv_0 = texcoord * uv_scale;
#endif
#ifdef COLOR_0_LOC
    color_multiplier = vertex_color;
#endif
}
