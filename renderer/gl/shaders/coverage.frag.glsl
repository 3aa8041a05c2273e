#version 330 core
// One bit per group of parts, OR-ed over everything that lies behind a pixel (no depth test).
uniform vec4 bits;
out vec4 color;
CUTTING
void main() {
    cut();
    color = bits;
}
