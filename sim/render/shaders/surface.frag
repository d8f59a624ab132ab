#version 330 core

in vec3 v_ray;
in vec3 v_color;
in vec3 v_sun;
in vec3 v_ambient;
uniform float haze_per_m;
uniform vec3 haze_color;
uniform float exposure;
#ifdef WITH_GLOSS
in vec3 v_normal;
in float v_gloss;
uniform sampler2D sky;
uniform vec3 to_sun;
uniform vec3 sun_glint;
#endif
#ifdef WITH_MIRRORS
uniform sampler2D town;                  // height [m], brightness, share that glints; fixed to the world
uniform float town_m;                    // its period
uniform vec3 town_eye;                   // camera centre in the world, x and y within a period
uniform float mirrors;
uniform vec3 front_light;                // on what stands around, and of its windows in the sun
uniform vec3 front_glint;
#endif
#ifdef WITH_SHADE
uniform sampler2D shade;                 // share of the sun that is hidden; fixed to the world
uniform float shade_share;
uniform vec2 shade_eye;                  // the camera centre's place in the pattern
uniform vec3 shade_across;               // world to pattern, along the sun's rays
uniform vec3 shade_along;
#endif
#ifdef WITH_TEXTURE
in vec2 v_uv;
uniform sampler2D image;
#endif
#ifdef WITH_STRETCH
// Three samples along the footprint's longer axis: sharp across the view at grazing angles, where isotropic mipmaps
// blur, at a tenth of the cost of Mesa's anisotropic filter.
vec3 stretched(sampler2D map, vec2 at)
{
    vec2 size = vec2(textureSize(map, 0));
    vec2 dx = dFdx(at) * size;
    vec2 dy = dFdy(at) * size;
    float xx = dot(dx, dx);
    float yy = dot(dy, dy);
    float lod = 0.5 * log2(max(max(xx, yy) / 9.0, min(xx, yy)));
    vec2 step = (xx > yy ? dx : dy) / (3.0 * size);
    return (textureLod(map, at - step, lod).rgb + textureLod(map, at, lod).rgb + textureLod(map, at + step, lod).rgb) / 3.0;
}
#endif
#ifdef WITH_SHADOWS
in vec3 v_sun_box;
in vec3 v_zenith_box;
uniform sampler2DShadow sun_map;
uniform sampler2DShadow zenith_map;
uniform vec2 sun_step;                   // penumbra and occlusion radius in map coordinates
uniform vec2 zenith_step;
#endif
out vec4 pixel;

// Filmic response (Narkowicz's fit of ACES, 2016), then gamma 2; the same in surface.frag and sky.frag.
vec3 tone(vec3 light)
{
    return sqrt(clamp(light * (2.51 * light + 0.03) / (light * (2.43 * light + 0.59) + 0.14), 0.0, 1.0));
}

#ifdef WITH_SHADOWS
float lit(sampler2DShadow map, vec3 p, vec2 d)
{
    return 0.25 * (texture(map, p + vec3(d.x, 0.4 * d.y, 0.0)) + texture(map, p + vec3(-0.4 * d.x, d.y, 0.0)) +
                   texture(map, p + vec3(-d.x, -0.4 * d.y, 0.0)) + texture(map, p + vec3(0.4 * d.x, -d.y, 0.0)));
}
#endif

void main()
{
    vec3 albedo = v_color;
#ifdef WITH_TEXTURE
#ifdef WITH_STRETCH
    albedo *= stretched(image, v_uv);
#else
    albedo *= texture(image, v_uv).rgb;
#endif
#endif
    float sunlit = 1.0;
    float open = 1.0;
#ifdef WITH_SHADOWS
    sunlit = lit(sun_map, v_sun_box, sun_step);
    open = 0.35 + 0.65 * lit(zenith_map, v_zenith_box, zenith_step);
#endif
#ifdef WITH_SHADE
    sunlit *= 1.0 - shade_share * texture(shade, shade_eye + vec2(dot(shade_across, v_ray), dot(shade_along, v_ray))).r;
#endif
    vec3 light = albedo * (v_sun * sunlit + v_ambient * open);
#ifdef WITH_GLOSS
    float inverse = inversesqrt(dot(v_ray, v_ray));
    vec3 ray = v_ray * inverse;
    vec3 n = normalize(v_normal);
    float cosine = clamp(-dot(ray, n), 0.0, 1.0);
    vec3 mirrored = ray + 2.0 * cosine * n;
    float grazing = (1.0 - cosine) * (1.0 - cosine);
    // Schlick's Fresnel term; surfaces of little gloss are rough and mirror a blurred sky.
    float share = v_gloss + (1.0 - v_gloss) * grazing * grazing * (1.0 - cosine) * min(1.0, 16.0 * v_gloss);
    float smoothness = min(1.0, 24.0 * v_gloss);
    vec2 at = 0.5 + 0.5 * mirrored.xy * inversesqrt(2.0 * max(1.0 + mirrored.z, 0.002));
    vec3 seen = textureLod(sky, at, 6.0 * (1.0 - smoothness)).rgb;
#ifdef WITH_MIRRORS
    // What the mirrored ray meets 12 m away: houses and trees that stand still while the mirror moves.
    vec3 met = town_eye + v_ray + mirrored * (12.0 / max(length(mirrored.xy), 0.1));
    vec3 house = texture(town, met.xy / town_m).rgb;
    float edge = max(0.1, fwidth(met.z));
    float wall = smoothstep(-edge, edge, house.r - met.z) * smoothstep(-edge, edge, met.z);
    vec3 front = front_light * house.g + front_glint * house.b;
    seen = mix(seen, front, wall * min(1.0, 3.0 * mirrors) * smoothness);
    share = min(0.9, share * (1.0 + 2.5 * mirrors * smoothness));
#endif
    float glint = clamp(dot(mirrored, to_sun), 0.0001, 1.0);
    seen = seen * mix(open, 1.0, 0.35) + sun_glint * (pow(glint, 1500.0) * sunlit * smoothness);
    light = mix(light, seen, share);
    float distance = inverse * dot(v_ray, v_ray);
#else
    float distance = sqrt(dot(v_ray, v_ray));
#endif
    light = mix(haze_color, light, exp2(-haze_per_m * distance));
    pixel = vec4(tone(light * exposure), 1.0);
}
