#version 330 core

in vec3 v_ray;
uniform sampler2D sky;
uniform float exposure;
out vec4 pixel;

// Filmic response (Narkowicz's fit of ACES, 2016), then gamma 2; the same in surface.frag and sky.frag.
vec3 tone(vec3 light)
{
    return sqrt(clamp(light * (2.51 * light + 0.03) / (light * (2.43 * light + 0.59) + 0.14), 0.0, 1.0));
}

void main()
{
    vec3 ray = normalize(v_ray);
    vec2 at = 0.5 + 0.5 * ray.xy * inversesqrt(2.0 * max(1.0 + ray.z, 0.002));
    pixel = vec4(tone(textureLod(sky, at, 0.0).rgb * exposure), 1.0);
}
