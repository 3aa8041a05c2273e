// The main function after the declarations of pyrender's mesh.frag (MIT licence), from whose main
// it differs: directional lights only; back faces are lit; metallic and roughness maps as in
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

    for (int i = 0; i < MAX_DIRECTIONAL_LIGHTS; i++) {
        vec3 v = normalize(cam_pos - frag_position);
        vec3 l = normalize(-1.0 * directional_lights[i].direction);
        vec3 radiance = directional_lights[i].intensity * directional_lights[i].color;
        vec3 res = compute_brdf(n, v, l, roughness, metallic, f0, c_diff, base_color.rgb, radiance);
#ifdef DIRECTIONAL_LIGHT_SHADOWS
        float nl = clamp(dot(n, l), 0.0, 1.0);
        float shadow = shadow_calc(
            directional_lights[i].light_matrix, directional_lights[i].shadow_map, nl);
        res = res * (1.0 - shadow);
#endif
        color.xyz += res;
    }
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
