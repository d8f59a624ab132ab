#version 330 core

in vec3 v_ray;
uniform sampler2D sky;
uniform float exposure;
out vec4 pixel;

// Filmic response with its gamma, a rational fit (Hejl and Burgess-Dawson 2010); the same in surface.frag and sky.frag.
vec3 tone(vec3 light)
{
    vec3 x = max(light - 0.004, 0.0);
    return (x * (6.2 * x + 0.5)) / (x * (6.2 * x + 1.7) + 0.06);
}

void main()
{
    vec3 ray = normalize(v_ray);
    vec2 at = 0.5 + 0.5 * ray.xy * inversesqrt(2.0 * max(1.0 + ray.z, 0.002));
    pixel = vec4(tone(textureLod(sky, at, 0.0).rgb * exposure), 1.0);
}
