#version 330 core

uniform mat4 ray_of_clip;                // clip coordinates to world direction, in the upper left 3 x 3
out vec3 v_ray;

void main()
{
    vec2 p = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
    v_ray = (ray_of_clip * vec4(p, 1.0, 0.0)).xyz;
    gl_Position = vec4(p, 1.0, 1.0);
}
