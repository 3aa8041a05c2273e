// The main function after the declarations of pyrender's mesh.frag (MIT licence), from whose main
// it differs: directional lights only, with unit directions; back faces are lit; metallic and roughness maps as in
// glTF 2.0 (roughness green, metallic blue); vertex colours belong to the base colour; emission
// counts once; alpha may cut holes; mirrored textures keep the sign of their second axis.
uniform float alpha_cutoff;

vec3 mapped_normal()
{
#ifdef HAS_NORMAL_TEX
    vec3 pos_dx = dFdx(frag_position);
    vec3 pos_dy = dFdy(frag_position);
    vec3 tex_dx = dFdx(vec3(uv_0, 0.0));
    vec3 tex_dy = dFdy(vec3(uv_0, 0.0));
    vec3 t = (tex_dy.t * pos_dx - tex_dx.t * pos_dy) / (tex_dx.s * tex_dy.t - tex_dy.s * tex_dx.t);
    vec3 ng = normalize(frag_normal);
    t = normalize(t - ng * dot(ng, t));
    vec3 b = cross(ng, t);
    float turn = tex_dx.s * tex_dy.t - tex_dy.s * tex_dx.t;
    if (abs(turn) < 1e-20) return ng;
    if (dot(b, (tex_dx.s * pos_dy - tex_dy.s * pos_dx) / turn) < 0.0) b = -b;
    mat3 tbn_n = mat3(t, b, ng);
    vec3 n = texture(material.normal_texture, uv_0).rgb;
    n = normalize(tbn_n * ((2.0 * n - 1.0) * vec3(1.0, 1.0, 1.0)));
    return n;
#else
    return frag_normal;
#endif
}

// What pyrender's compute_brdf returns, for all lights of a fragment: l + v is not normalised, and
// the fractions of the specular part are one. Software renderers spend most of their time here.
vec3 reflected(vec3 n, vec3 v, float roughness, vec3 f0, vec3 c_diff)
{
    float n_v = dot(n, v), nv = clamp(abs(n_v), 0.001, 1.0);
    float k = (roughness + 1.0) * (roughness + 1.0) * 0.125;
    float a2 = roughness * roughness * roughness * roughness;
    float seen = nv * a2 / (PI * (nv * (1.0 - k) + k));
    vec3 diffuse = c_diff / PI, sum = vec3(0.0);
    for (int i = 0; i < MAX_DIRECTIONAL_LIGHTS; i++) {
        vec3 l = -directional_lights[i].direction;
        float n_l = dot(n, l), nl = clamp(n_l, 0.001, 1.0);
        float h2 = max(2.0 + 2.0 * dot(l, v), 1e-12), nh = max(n_l + n_v, 0.0); // times |l + v|
        float away = 1.0 - min(0.5 * sqrt(h2), 1.0), away2 = away * away;
        vec3 f = f0 + (1.0 - f0) * (away2 * away2 * away);
        float d = h2 + nh * nh * (a2 - 1.0);
        float specular = nl * seen * h2 * h2
            / ((nl * (1.0 - k) + k) * d * d * (4.0 * nl * nv + 0.001));
        vec3 res = nl * directional_lights[i].color * (diffuse + f * (specular - diffuse));
#ifdef DIRECTIONAL_LIGHT_SHADOWS
        res *= 1.0 - shadow_calc(directional_lights[i].light_matrix,
                                 directional_lights[i].shadow_map, clamp(n_l, 0.0, 1.0));
#endif
        sum += res;
    }
    return sum;
}

void main()
{
    vec4 color = vec4(vec3(0.0), 1.0);

    float roughness = material.roughness_factor;
    float metallic = material.metallic_factor;
#ifdef HAS_METALLIC_ROUGHNESS_TEX
    vec2 mr = texture(material.metallic_roughness_texture, uv_0).gb;
    roughness = roughness * mr.r;
    metallic = metallic * mr.g;
#endif
    roughness = clamp(roughness, min_roughness, 1.0);
    metallic = clamp(metallic, 0.0, 1.0);

    vec4 base_color = material.base_color_factor;
#ifdef HAS_BASE_COLOR_TEX
    base_color = base_color * srgb_to_linear(texture(material.base_color_texture, uv_0));
#endif
#ifdef COLOR_0_LOC
    base_color *= color_multiplier;
#endif
#ifdef CUT
    if (base_color.a < alpha_cutoff) discard;
#endif
    vec3 c_diff = mix(vec3(0.0), base_color.rgb * (1 - min_roughness), 1.0 - metallic);
    vec3 f0 = mix(vec3(min_roughness), base_color.rgb, metallic);

    vec3 n = normalize(mapped_normal());
    if (!gl_FrontFacing) n = -n;

    color.xyz += reflected(n, normalize(cam_pos - frag_position), roughness, f0, c_diff);
    color.xyz += base_color.xyz * ambient_light;
#ifdef UNLIT
    color.xyz = base_color.rgb;
#endif
#ifdef HAS_OCCLUSION_TEX
    color.xyz *= texture(material.occlusion_texture, uv_0).r;
#endif
    vec3 emissive = material.emissive_factor;
#ifdef HAS_EMISSIVE_TEX
    emissive *= srgb_to_linear(texture(material.emissive_texture, uv_0)).rgb;
#endif
    color.xyz += emissive;
    frag_color = clamp(vec4(pow(color.xyz, vec3(1.0/2.2)), color.a * base_color.a), 0.0, 1.0);
}
