#if CUT
// Where a material's alpha is less than its cutoff there is no surface.
in vec2 uv;
in float vertex_alpha;
uniform sampler2D picture;
uniform float alpha;
uniform float cutoff;
void cut() { if (texture(picture, uv).a * vertex_alpha * alpha < cutoff) discard; }
#else
void cut() {}
#endif
