#version 330 core

layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 uv;
layout(location = 3) in vec4 color_gloss;
layout(location = 4) in mat4 model;      // item to anchor (world axes, origin near the camera)

uniform mat4 camera;                     // anchor to clip
uniform vec3 eye;                        // camera centre in the anchor frame
uniform vec3 to_sun;
uniform vec3 sun;
uniform vec3 sky_light;                  // ambient light from above and from below
uniform vec3 ground_light;
#ifdef WITH_SHADOWS
uniform mat4 sun_box;                    // anchor to the light box, 0..1
uniform mat4 zenith_box;
uniform float sun_texel_m;
uniform float occlusion_m;
out vec3 v_sun_box;
out vec3 v_zenith_box;
#endif

out vec3 v_ray;                          // camera centre to surface point
out vec3 v_color;
out vec3 v_sun;
out vec3 v_ambient;
#ifdef WITH_GLOSS
out vec3 v_normal;
out float v_gloss;
#endif
#ifdef WITH_TEXTURE
out vec2 v_uv;
#endif

void main()
{
    vec4 p = model * vec4(position, 1.0);
    vec3 n = mat3(model) * normal;
    float facing = max(dot(n, to_sun), 0.0);
    v_ray = p.xyz - eye;
    v_color = color_gloss.rgb;
    v_sun = sun * facing;
    v_ambient = mix(ground_light, sky_light, 0.5 + 0.5 * n.z);
#ifdef WITH_GLOSS
    v_normal = n;
    v_gloss = color_gloss.a;
#endif
#ifdef WITH_TEXTURE
    v_uv = uv;
#endif
#ifdef WITH_SHADOWS
    // Moved off the surface by about a texel, more where light grazes: no surface shadows itself.
    v_sun_box = (sun_box * vec4(p.xyz + n * sun_texel_m * (2.5 - 1.5 * facing), 1.0)).xyz;
    v_zenith_box = (zenith_box * vec4(p.xyz + n * occlusion_m + vec3(0.0, 0.0, 0.05), 1.0)).xyz;
#endif
    gl_Position = camera * p;
}
