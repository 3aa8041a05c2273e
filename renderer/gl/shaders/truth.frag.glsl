#version 330 core
// 1 / gl_FragCoord.w is z in the camera frame: the last row of the projection is (0, 0, 1, 0).
uniform uint part;
layout(location = 0) out float depth;
layout(location = 1) out uint part_number;
#if FACES
uniform uint first_face;
layout(location = 2) out uint face_number;
#endif
CUTTING
void main() {
    cut();
    depth = 1.0 / gl_FragCoord.w;
    part_number = part;
#if FACES
    face_number = first_face + uint(gl_PrimitiveID) + 1u;
#endif
}
